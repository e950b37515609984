"""`tulip watch`: what it says of postures as they come, and when it says stop."""

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests import edited_rows
from tests.edited_rows import changed, plus
from tests.test_refusals import check_words, rows
from tulip_testbed.experiments.watching.alarm import (
    CHANGED,
    OK,
    REPEAT,
    fault_of_changes,
    largest_ratio,
    level,
)
from tulip_testbed.experiments.watching.day_model import DayModel, day_model
from tulip_testbed.experiments.watching.row_columns import row_columns
from tulip_testbed.experiments.watching.watch_row import UNUSABLE, Verdict, planned_row, watch_row
from tulip_testbed.experiments.watching.watch_state import (
    AGAIN,
    OF_PLACEMENT,
    OPEN,
    Changes,
    Innovation,
    WatchState,
    first_state,
)
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.reading_noise import ReadingNoise, placement_levers, reading_noise
from tulip_testbed.identification.regressor import regression
from tulip_testbed.identification.variance_components import MARK_RATIO

SEED, ONSET = 3, 35


def measured_day(robot: tt.Robot, plan: tt.PosturePlan) -> tt.Measurements:
    """Measure the plan's first placements by statics."""
    few = plan.take(plan.placement <= 9)
    return tt.Laboratory(robot, "force-plate").run(few, SEED, "statics").measurements


def one_row(rows: tt.Measurements, k: int) -> tt.Measurements:
    return rows.take(np.array([k]))


def play(
    model: DayModel, rows: tt.Measurements, state: WatchState | None = None, targets: np.ndarray | None = None
) -> tuple[WatchState, list[Verdict]]:
    state, out = state or first_state(model), []
    for k in range(len(rows)):
        state, verdict = watch_row(model, state, one_row(rows, k), targets)
        out.append(verdict)
    return state, out


@pytest.fixture(scope="module")
def day(robot, plan) -> tt.Measurements:
    return measured_day(robot, plan)


@pytest.fixture(scope="module")
def watched(robot, plan, day):
    return day_model(plan.take(plan.placement <= 9), robot, day)


@pytest.fixture(scope="module")
def played(watched, day):
    return play(watched, day)


@pytest.fixture(scope="module")
def before(watched, day):
    """The state before row `ONSET` of a clean day."""
    return play(watched, day.take(np.arange(ONSET)))[0]


def slipped(day: tt.Measurements, angle: float, first: int = ONSET) -> tt.Measurements:
    """The right knee's encoder slips: every row from `first` on reads an angle too much."""
    return changed(day, joint_angles=plus(angle, slice(first, None), day.joints.index("right_knee")))


def test_a_row_alone_has_the_columns_that_it_has_among_others(watched, day):
    whole, alone = row_columns(watched, day).row(17), row_columns(watched, one_row(day, 17)).row(0)
    for one in fields(whole):
        np.testing.assert_allclose(getattr(alone, one.name), getattr(whole, one.name), rtol=1e-9, atol=1e-12)


def after_readings(values, variance, ramps) -> Changes:
    """The evidence for changes of one fault after readings without any state."""
    changes, one = Changes.none(1, 1), np.ones((1, 1))
    for k, value in enumerate(values):
        here: Any = SimpleNamespace(state=0 * one, faults=one)
        innovation = Innovation(value * one[0], variance * one, one / variance, 0 * one, here)
        changes = changes.with_row(innovation, k, np.full(1, ramps))
    return changes


def test_evidence_for_a_step_by_hand():
    """Readings of variance 4; a step of 3 begins at the third row: y^2 / w = n 3^2 / 4."""
    changes = after_readings([0.0, 0.0, 3.0, 3.0, 3.0, 3.0], 4, False)
    assert changes.ratio[:, 0].max() == pytest.approx(4 * 9 / 4)
    assert changes.onset[changes.ratio[:, 0].argmax()] == 2


def test_evidence_for_a_ramp_by_hand():
    """A ramp of 0.1 plausible size a row, measured with variance 1: y^2 / w = sum (k / 10)^2."""
    changes = after_readings([(k + 1) / 10 for k in range(5)], 1, True)
    assert changes.ratio[0, 0] == pytest.approx(55 / 100)


def test_a_clean_day_is_in_order(played, watched):
    state, verdicts = played
    assert {one.verdict for one in verdicts} == {OK}
    assert state.fault is None
    assert verdicts[0].next == 2
    assert verdicts[-1].left == int((state.done != 1).sum())


def test_a_slip_is_noticed_at_once_named_and_its_end_too(watched, day, before, played):
    number, slip = int(day.posture[ONSET]), np.radians(0.4)
    bad = slipped(slipped(day, slip), -slip, ONSET + 6)
    state, verdicts = play(watched, bad.take(np.arange(ONSET, ONSET + 12)), before)
    assert verdicts[0].verdict in (REPEAT, CHANGED)
    assert verdicts[0].next == number
    changed = [one for one in verdicts if one.verdict == CHANGED]
    assert changed[0].onset == changed[0].next == number
    assert "right_knee" in changed[0].findings[0].seen
    clean = played[1][ONSET - 1].standard_errors
    assert all(one.standard_errors == clean and not one.stop for one in changed)
    assert state.fault is None
    assert verdicts[-1].verdict == OK
    assert any("is gone" in finding.seen for one in verdicts for finding in one.findings)


def test_one_odd_posture_is_to_be_repeated_and_then_forgotten(watched, day, before):
    odd = slipped(day, np.radians(1.0))
    state, (verdict,) = play(watched, one_row(odd, ONSET), before)
    assert verdict.verdict == REPEAT
    assert verdict.next == int(day.posture[ONSET])
    _, verdicts = play(watched, day.take(np.arange(ONSET + 1, ONSET + 6)), state)
    assert {one.verdict for one in verdicts} == {OK}


@rows("watch")
def test_a_row_is_judged_and_told_why(watched, day, changes, words):
    count = int(changes[0])
    names = {"row": one_row(day, count), "day": day, "replace": replace, "np": np} | vars(edited_rows)
    state, _ = play(watched, day.take(np.arange(count)))
    _, (verdict,) = play(watched, eval(changes[1], names), state)
    check_words(words, " ".join([str(verdict), *(one.advice for one in verdict.findings)]))


def test_it_stops_when_the_targets_are_met_and_says_what_is_left(watched, day, played, before):
    errors = np.array(list(played[1][-1].standard_errors.values()))
    assert np.isfinite(errors).all()
    _, verdicts = play(watched, day, targets=1.2 * errors)
    stops = [one for one in verdicts if one.stop]
    assert stops
    assert stops[0].stop == f"the targets are met; {stops[0].left} postures are left"
    assert all(e <= 1.2 * t for e, t in zip(stops[0].standard_errors.values(), errors, strict=True))
    _, (verdict,) = play(watched, one_row(day, ONSET), before, targets=0.1 * errors)
    assert verdict.stop == ""


def test_the_standard_errors_are_those_of_generalised_least_squares(robot, day, played):
    nominal = nominal_robot(robot)
    matrix = regression(nominal.parameters, day, robot).matrix.reshape(len(day), 2, -1)
    noise = reading_noise(day, nominal)
    left = np.array(day.sensors.placement_sd)  # the foot on the right plate stands on a mark
    levers = placement_levers(day) * np.concatenate([MARK_RATIO * left, left])
    noise = ReadingNoise(noise.own, levers, day.placement)
    expected = np.linalg.inv(np.tensordot(matrix, noise.weights(matrix), axes=((0, 1), (0, 1))))
    found = np.array(list(played[1][-1].standard_errors.values()))
    np.testing.assert_allclose(found, np.sqrt(np.diag(expected)), rtol=0.01)


def test_the_limits_follow_from_the_plan(watched, robot, plan, day):
    longer = day_model(plan, robot, day)
    assert level(longer, "row") < level(watched, "row")
    assert largest_ratio(longer) > largest_ratio(watched)


def test_what_was_measured_since_a_change_began_is_forgotten(watched, before):
    first = before.count - 3
    slot = int(np.flatnonzero(before.changes.onset == first)[0])
    pull = before.changes.pull.copy()
    pull[slot] = 100 * np.sqrt(before.changes.information[slot])
    seen = replace(before, changes=replace(before.changes, pull=pull))
    state = fault_of_changes(watched, seen)
    assert state.fault is not None
    since, until = list(before.taken[-3:]), list(before.taken[:-3])
    postures = watched.plan.posture
    assert state.fault.posture == postures[since[0]]
    assert set(postures[[*since, *until]]) <= before.earlier.keys()
    assert not set(postures[since]) & state.earlier.keys()
    assert set(postures[until]) <= state.earlier.keys()
    # The foot was put down anew since, so that its place is as unknown as at the beginning of a placement.
    state = fault_of_changes(watched, replace(seen, stance=seen.stance + 1))
    np.testing.assert_array_equal(
        state.belief.covariance[-OF_PLACEMENT:, -OF_PLACEMENT:],
        watched.covariance[-OF_PLACEMENT:, -OF_PLACEMENT:],
    )


def test_a_row_that_came_twice_counts_once(watched, day):
    once, _ = play(watched, one_row(day, 0))
    twice, (verdict,) = play(watched, one_row(day, 0), once)
    assert verdict.verdict == UNUSABLE
    assert "same time" in verdict.findings[0].seen
    assert verdict.next == int(day.posture[1])
    np.testing.assert_array_equal(twice.done, once.done)
    assert twice.count == 1


def test_a_posture_that_is_measured_again_is_not_taken_for_its_repeat_elsewhere(watched):
    """Posture 5 opens placement 1 and is repeated in placement 7."""
    plan = SimpleNamespace(posture=np.array([5, 6, 5]), placement=np.array([1, 1, 7]))
    model: Any = SimpleNamespace(plan=plan, held=True)
    state: Any = SimpleNamespace(done=np.array([AGAIN, OPEN, OPEN]))
    assert planned_row(model, state, 5, 1) == 0
    assert planned_row(model, state, 5, 7) == 2
    assert planned_row(model, state, 5, 3) == 2  # in neither: the one that is open
    assert planned_row(model, state, 7, 1) is None
