"""Finding the missing effect: residuals, evidence, verdicts, the adopted model."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from studies.hidden_effects.outside_faults import FAULTS
from tests.effect_changes import DISCOVERY_SEED as SEED
from tests.effect_changes import measured
from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.families import EXACT, TOLERANCES
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.calibration.ordinary_laboratory import ordinary_members
from tulip_testbed.discovery.candidates import Fitted, candidates, standing_out
from tulip_testbed.discovery.discover import _reasons, discover, stands_out
from tulip_testbed.discovery.effect_intervals import TIME_GAIN
from tulip_testbed.discovery.next_experiment import doubts_of, rank_experiments
from tulip_testbed.discovery.patterns import patterns
from tulip_testbed.discovery.story import WORTHWHILE, story
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import check_instances
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_noise import noise_of
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics


def names(found):
    return [(o.effect.name, o.target) for o in found.adopted]


def after(found):
    assert found.heldout is not None
    return found.heldout.after


def before(found):
    assert found.heldout is not None
    return found.heldout.before


def floor(found):
    assert found.heldout is not None
    return found.heldout.floor


def interval(found, number):
    (one,) = found.adopted
    assert one.intervals[number] is not None
    return one.intervals[number]


def test_a_pattern_tells_the_reading_that_errs(robot, plan, nominal):
    joint = plan.joints.index("right_knee")

    def bent(m):
        angles = m.joint_angles.copy()
        angles[:, joint] += 0.01 * (angles[:, joint] - 0.7) ** 2
        return dataclasses.replace(m, joint_angles=angles)

    rig = dataclasses.replace(preset_rig("force-plate", robot), misread=bent)
    observed = observe(
        run_statics(solve_plan(rig, plan), [np.random.SeedSequence(SEED)])[0].measurements, nominal
    )
    linear = linear_model(observed, noise_of(observed))
    clearest = patterns(linear, linear.residual, np.zeros((len(linear.residual), 0)))[0]
    assert clearest.words.startswith("the reading of right_knee errs with")


@pytest.mark.parametrize("preset", ["wii", pytest.param("force-plate", marks=pytest.mark.slow)])
def test_no_gap_no_name(robot, plan, preset):
    found = discover(measured(robot, plan, preset), robot)
    assert found.verdict == "none"
    assert found.adopted == ()
    assert after(found)["AFTC"] < floor(found)["AFTC"]
    assert "No gap" in story(found, [])[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "name", "target", "value"),
    [
        pytest.param("wii", "encoder-offset", "left_ankle_roll", 0.012, marks=pytest.mark.slow),
        ("force-plate", "joint-compliance", "right_ankle_roll", 0.0008),
        pytest.param("wii", "sole-compliance", "", 0.0008, marks=pytest.mark.slow),
        pytest.param("wii", "cell-gain", "left.rear_left", 0.12, marks=pytest.mark.slow),
        pytest.param("force-plate", "thermal-gain-drift", "", -0.01, marks=pytest.mark.slow),
    ],
)
def test_a_hidden_effect_is_named_sized_and_predicts(robot, plan, preset, name, target, value):
    found = discover(measured(robot, plan, preset, (name, target, (value,))), robot)
    assert found.verdict == "named"
    assert names(found) == [(name, target)]
    low, high = interval(found, 0)
    middle, half = (low + high) / 2, (high - low) / 2
    assert abs(value - middle) < 1.5 * half  # five cases at once: 1.5 half widths is 99.7 %
    assert after(found)["AFTC"] < min(1.1, before(found)["AFTC"])
    assert found.heldout is not None
    worse = dataclasses.replace(found.heldout, after=after(found) | {"T": 1.2})
    assert "channel T" in " ".join(_reasons(found.selection, found.patterns[0], worse))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "name", "target", "value"),
    [
        pytest.param("wii", "encoder-offset", "left_ankle_roll", 0.003, marks=pytest.mark.slow),
        ("force-plate", "joint-compliance", "right_ankle_roll", 0.0002),
    ],
)
def test_a_small_fault_is_an_ordinary_imperfection(robot, plan, preset, name, target, value):
    """It is the clearest of them, with its interval; nothing is named."""
    found = discover(measured(robot, plan, preset, (name, target, (value,))), robot)
    assert found.verdict == "calibrated"
    assert found.adopted == ()
    clearest = max(found.calibrated, key=_clarity)
    assert (clearest.effect.name, clearest.target) == (name, target)
    assert clearest.intervals[0] is not None
    low, high = clearest.intervals[0]
    assert abs(value - (low + high) / 2) < 1.5 * (high - low) / 2


def _clarity(one):
    low, high = one.intervals[0]
    return abs(one.values[0]) / (high - low)


@pytest.mark.parametrize("preset", ["force-plate", pytest.param("wii", marks=pytest.mark.slow)])
def test_an_ordinary_laboratory_has_no_single_cause(robot, plan, preset):
    """Every encoder, cell, link and joint is a little off, and the masses are unknown."""
    rng = np.random.default_rng(9100)
    masses = draw_robot(robot.model, 0.1, rng)
    rig = edited(preset_rig(preset, robot), edit_of(robot.model, masses))
    hidden = ordinary_members(rig, rng)
    laboratory = Laboratory(robot, preset, hidden=hidden, nominal=rig)
    found = discover(laboratory.run(plan, 9100, "statics").measurements, robot)
    assert found.verdict == "calibrated"
    true = {one.label: one.values for one in hidden}
    inside = [
        interval[0] <= value <= interval[1]
        for one in found.calibrated
        for value, interval in zip(true[one.label], one.intervals, strict=True)
        if interval is not None
    ]
    assert np.mean(inside) > 0.85


def test_without_times_a_lost_posture_may_mean_a_foot_put_down_anew(robot, plan, nominal):
    m = measured(robot, plan.take(plan.placement <= 2), "ideal")
    kept = m.take((m.posture != 3) & ~np.isin(np.arange(len(m)), _repeats(m)))
    timed, timeless = (observe(one, nominal).stance for one in (kept, _timeless(kept)))
    assert timed.tolist() == timeless.tolist()
    assert len(np.unique(timeless)) == 3


def _repeats(m):
    first = np.unique(m.posture, return_index=True)[1]
    return np.setdiff1d(np.arange(len(m)), first)


def _timeless(m):
    return dataclasses.replace(m, time=np.full(len(m), np.nan))


@pytest.mark.slow
def test_a_knee_that_yields_by_degrees_is_sized_through_the_laboratory(robot, plan):
    """The formula alone is 8 % off: the whole robot sinks and shifts its load."""
    data = measured(robot, plan, "force-plate", ("joint-compliance", "right_knee", (8e-4,)))
    found = discover(data, robot, hold_out=False)
    assert names(found) == [("joint-compliance", "right_knee")]
    assert found.adopted[0].values[0] == pytest.approx(8e-4, rel=0.02)
    assert interval(found, 0)[0] < 8e-4 < interval(found, 0)[1]


@pytest.mark.slow
def test_a_change_in_time_is_found_between_two_postures(robot, plan):
    data = measured(robot, plan, "wii", ("encoder-slip", "right_knee", (0.004, 0.47)))
    found = discover(data, robot, hold_out=False)
    assert names(found) == [("encoder-slip", "right_knee")]
    low, high = interval(found, 1)
    assert low <= 0.47 <= high
    assert high - low < 0.05


@pytest.mark.slow
def test_exchanged_cells_are_found_and_undone(robot, plan):
    found = discover(measured(robot, plan, "force-plate", ("swapped-cells", "right", (0.0, 2.0))), robot)
    assert names(found) == [("swapped-cells", "right")]
    assert found.adopted[0].values == (0.0, 2.0)
    assert after(found)["AFTC"] < 1.1


@pytest.mark.slow
def test_twins_are_not_named_and_an_experiment_is_proposed(robot, plan):
    tare = measured(robot, plan, "wii", ("cell-tare", "left.rear_left", (4.0,)))
    found = discover(tare, robot, tolerances=EXACT)
    assert found.verdict == "ambiguous"
    assert found.adopted == ()
    labels = {one.label for one in found.equivalents[0]}
    assert {"cell-tare:left.rear_left", "cell-tare:left.front_right"} <= labels
    doubts = doubts_of(found.verdict, found.explanations)
    ranking = rank_experiments(tare, robot, doubts)
    assert ranking[0].settled > WORTHWHILE
    (advice,) = [line for line in story(found, ranking) if line.startswith("To separate them")]
    assert f"({ranking[0].words})" in advice
    assert "measure the quantity in question directly" in " ".join(story(found, []))


@pytest.mark.slow
def test_two_effects_are_both_named(robot, plan):
    hidden = (("encoder-gain", "left_knee", (0.01,)), ("cell-gain", "right.front_left", (0.02,)))
    found = discover(measured(robot, plan, "force-plate", *hidden), robot, hold_out=False)
    assert found.verdict == "named"
    assert sorted(names(found)) == sorted((name, target) for name, target, _ in hidden)


@pytest.mark.slow
def test_what_neither_the_catalogue_nor_a_law_says_is_unknown(robot, plan):
    """A cable that pulls on one side only: no law has a force that follows the posture."""
    (slack,) = [one for one in FAULTS if one.name == "cable-slack"]
    rig = slack.inject(preset_rig("force-plate", robot), 7, 20.0)
    data = run_statics(solve_plan(rig, plan), [np.random.SeedSequence(SEED)])[0].measurements
    found = discover(data, robot)
    assert found.verdict == "unknown"
    assert found.where
    assert found.adopted == ()


@pytest.mark.parametrize(
    ("sheet", "word"),
    [
        pytest.param({"cell_sd": 0.6}, "cells", marks=pytest.mark.slow),
        pytest.param({"encoder_sd": 1.5e-4}, "encoders", marks=pytest.mark.slow),
    ],
)
def test_repeats_overrule_a_data_sheet(robot, plan, sheet, word):
    honest = measured(robot, plan, "wii")
    boasting = dataclasses.replace(honest, sensors=dataclasses.replace(honest.sensors, **sheet))
    found = discover(boasting, robot, hold_out=False)
    assert found.verdict == "none"
    assert any(word in text for text in found.noise.assumed)


def test_a_calibration_that_does_not_converge_is_refused_in_one_sentence(robot, plan, monkeypatch):
    def diverges(*_, **__):
        raise np.linalg.LinAlgError

    monkeypatch.setattr("tulip_testbed.discovery.discover.select", diverges)
    run = Laboratory(robot, "wii").run(plan.take(plan.placement <= 8), seed=1, engine="statics")
    with pytest.raises(InputError, match="rows of which no calibration converges; expected a smaller fault"):
        discover(run.measurements, robot)


@pytest.mark.slow
def test_a_change_at_the_end_of_the_catalogue_s_times_is_found_there(robot, plan):
    """It lies between two postures, of which one is beyond the last time that a search tries."""
    data = measured(robot, plan, "force-plate", ("encoder-slip", "left_ankle_pitch", (0.0028, 0.9)))
    found = discover(data, robot, hold_out=False)
    assert names(found) == [("encoder-slip", "left_ankle_pitch")]
    low, high = interval(found, 0)
    assert low < 0.0028 < high
    check_instances(found.adopted, robot, "adopted")


@pytest.mark.slow
def test_two_of_one_family_do_not_hide_one_another(robot, plan):
    hidden = (("link-length", "left_lower_leg", (0.006,)), ("link-length", "right_ankle", (0.005,)))
    found = discover(measured(robot, plan, "force-plate", *hidden), robot, hold_out=False)
    assert set(names(found)) == {(name, target) for name, target, _ in hidden}


@pytest.mark.parametrize(
    ("size", "error", "outside"), [(3.4, 0.7, False), (3.4, 0.2, True), (2.9, 0.1, False)]
)
def test_a_member_is_an_effect_if_it_is_surely_unusual(robot, plan, nominal, size, error, outside):
    """An estimate of 3.4 tolerances with a wide interval may well be one of 2.6, which is ordinary."""
    observed = observe(Laboratory(robot, "wii").run(plan, 5, "statics").measurements, nominal)
    (one,) = [c for c in candidates(observed) if c.label == "joint-compliance:right_knee"]
    tolerance = TOLERANCES["joint-compliance"][0]
    term = Fitted(one, 0, np.array([size * tolerance]))
    selection: Any = SimpleNamespace(
        null=SimpleNamespace(data=SimpleNamespace(observed=observed)),
        tolerances=None,
        calibration=SimpleNamespace(families=()),
    )
    assert stands_out(selection, term, np.array([error * tolerance])) == outside


@pytest.mark.slow
def test_a_family_far_wider_than_usual_is_not_calibrated(robot, plan):
    """Vertical cells do not tell which plate lies 15 mm off; it is no ordinary imperfection."""
    hidden = ("plate-translation", "right", (0.012, -0.010))
    found = discover(measured(robot, plan, "force-plate", hidden), robot, hold_out=False)
    assert found.verdict == "ambiguous"
    labels = {one.label for one in found.equivalents[0]}
    assert {"plate-translation:right", "plate-translation:left"} <= labels
    (wide,) = [c for c in found.families if c.family.name == "plate-translation"]
    assert wide.spread < 2


def test_times_of_change_are_believed_as_far_as_95_percent_ask():
    """The likelihood ratio of a change point: the largest of two random walks that drift down."""
    rng = np.random.default_rng(11)
    jump, steps, draws = 0.15, 1500, 3000  # jump: in s.d. of a posture, small so that the limit holds
    walks = np.cumsum(jump * rng.standard_normal((2, draws, steps)) - jump**2 / 2, axis=2)
    ratio = 2 * np.maximum(walks.max(axis=(0, 2)), 0.0)
    assert (ratio < TIME_GAIN).mean() == pytest.approx(0.95, abs=0.015)


def test_of_many_placements_those_are_sought_that_stand_out(robot, plan, nominal, monkeypatch):
    monkeypatch.setattr("tulip_testbed.discovery.candidates.MOST_PLACEMENTS", 3)
    lab = Laboratory(robot, "wii").with_effects("placement-blunder:17=0.04,0.03")
    observed = observe(lab.run(plan, 5, "statics").measurements, nominal)
    numbers = standing_out(observed)
    assert len(numbers) == 3
    assert 17 in numbers
    sought = [c.target for c in candidates(observed) if c.effect.name == "placement-blunder"]
    assert sought == [str(number) for number in numbers]


@pytest.mark.slow
def test_a_family_of_one_member_is_named_however_unusual(robot, plan):
    """Which one is off is no question: a drift of all gains, 15 tolerances large."""
    hidden = ("thermal-gain-drift", "", (0.046,))
    found = discover(measured(robot, plan, "wii", hidden), robot, hold_out=False)
    assert names(found) == [hidden[:2]]
    low, high = interval(found, 0)
    assert low < 0.046 < high


def test_evidence_that_is_lost_on_the_way_is_a_reason():
    selection: Any = SimpleNamespace(lacks_fit=True, complete=True, calibration=SimpleNamespace(families=()))
    clearest: Any = SimpleNamespace(p=1.0)
    assert _reasons(selection, clearest, None) == ()
    (reason,) = _reasons(selection, clearest, None, ["tether:head"])
    assert "the evidence for tether:head is gone" in reason
