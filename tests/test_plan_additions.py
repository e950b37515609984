"""What a plan may hold beside its optimal postures: the next ones, repeats, postures on one foot."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from tulip_testbed.experiments.atlases.planned_experiment import usable
from tulip_testbed.experiments.described_plan import describe_plan
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.usable_plan import joined
from tulip_testbed.identification.planning.objectives import objectives
from tulip_testbed.identification.planning.one_foot import single_support_margins
from tulip_testbed.identification.planning.one_foot_search import (
    OnOneFoot,
    appended_on_one_foot,
    feasible_pool,
)
from tulip_testbed.identification.planning.optimal_plan import (
    SearchTask,
    after,
    measured_information,
    smallest_margins,
    with_repeats,
)
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning.search import search
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

SIGMA = 4.16e-3
SEED = 311


def measured(robot, plan, preset="wii", seed=SEED):
    (run,) = run_statics(solve_plan(preset_rig(preset, robot), plan), np.random.SeedSequence(seed).spawn(1))
    return run.measurements


@pytest.fixture(scope="module")
def problem(robot, plate):
    return planning_problem(robot, plate)


@pytest.fixture(scope="module")
def one_foot(robot, plate):
    return planning_problem(robot, plate, support="right")


@pytest.fixture(scope="module")
def optimal(robot, model, plan):
    return plan.take(plan.placement <= 8)


@pytest.fixture(scope="module")
def with_one_foot(one_foot, optimal):
    """Six postures on the stance foot after forty on both."""
    swing = optimal.swing_pose[-1]
    angles = feasible_pool(one_foot, swing, 6, np.random.default_rng(SEED), times=1)[:6]
    return appended_on_one_foot(optimal, OnOneFoot("right", one_foot, swing, angles))


@pytest.mark.slow
def test_the_next_placements_tell_more_than_random_ones(problem, robot, plate, plan):
    taken = measured(robot, plan.take(plan.placement <= 10))
    goal = objectives(SIGMA)["condition"]
    states = []
    found = SearchTask(problem, goal, 2, 5, SEED, 10, measured=taken).run(states.append)
    known = measured_information(problem, taken)

    def with_these(angles):
        rows = stacked_regressor(problem.parameters, angles)
        return goal.value(known + rows.T @ rows)

    random = random_postures(robot, plate, 2, 5, SEED + 1)
    assert with_these(found.joint_angles) == pytest.approx(found.made["final_objective"], rel=1e-9)
    assert with_these(found.joint_angles) < 0.85 * with_these(random.joint_angles)
    assert found.posture.min() > taken.posture.max()
    assert found.placement.tolist() == [11] * 5 + [12] * 5
    assert min(m["value"] for m in smallest_margins(problem, found).values()) > -1e-6
    *_, last = search(problem, after(problem, goal, taken), states[4], 5, SEED, 10)
    assert last.best_angles.tobytes() == states[-1].best_angles.tobytes()


def test_repeats_stand_in_the_plan_and_in_the_measurements(robot, model, optimal, tmp_path):
    plan = with_repeats(optimal, 7, SEED)
    within, anew = (plan.made["repeats"][key] for key in ("within_placement", "placed_anew"))
    assert (len(within), len(anew), len(plan), plan.postures) == (4, 3, len(optimal) + 7, len(optimal))
    for number in within + anew:
        first, second = np.flatnonzero(plan.posture == number)
        assert second > first + 1  # never at once
        np.testing.assert_array_equal(plan.joint_angles[first], plan.joint_angles[second])
        assert (plan.placement[first] == plan.placement[second]) == (number in within)
    write_plan(tmp_path / "plan", plan)
    again = read_plan(tmp_path / "plan", robot)
    held = measured(robot, again, "ideal")
    assert len(held) <= len(plan)  # the laboratory adds none of its own
    assert set(held.posture.tolist()) <= set(plan.posture.tolist())
    pairs = [np.flatnonzero(held.posture == number) for number in anew]
    assert any(len(np.unique(held.placement[rows])) == 2 for rows in pairs)


def test_feed_forward_holds_postures_on_one_foot_without_sag(robot, with_one_foot):
    """Statics of the laboratory's own scene, without friction and noise: angles are the plan's."""
    one = with_one_foot.take(with_one_foot.support == "right")
    rig, count = preset_rig("ideal", robot), one.joint_angles.shape[1]
    held = solve_plan(rig, one).reference
    assert held.solved.all()
    assert np.abs(held.state.angles[:, :count] - one.joint_angles).max() < 1e-4
    sagging = solve_plan(rig, dataclasses.replace(one, torques=None)).reference
    assert np.abs(sagging.state.angles[:, :count] - one.joint_angles).max() > 0.01


def test_torques_go_with_their_postures(robot, model, with_one_foot, tmp_path):
    """Through repeats, parts, the file, and beside postures that have none."""
    torques = dict(zip(with_one_foot.posture.tolist(), with_one_foot.feed_forward, strict=True))
    plan = with_repeats(with_one_foot, 7, SEED)
    plan = plan.take(np.arange(len(plan))[::-1])
    write_plan(tmp_path / "plan", plan)
    again = read_plan(tmp_path / "plan", robot)
    np.testing.assert_array_equal(again.feed_forward, [torques[number] for number in again.posture.tolist()])
    one = usable(with_one_foot, with_one_foot.posture[-6:])
    np.testing.assert_array_equal(one.feed_forward, with_one_foot.feed_forward[-6:])
    plain = dataclasses.replace(with_one_foot, torques=None)
    both = joined([plain, with_one_foot]).feed_forward
    np.testing.assert_array_equal(both[len(plain) :], with_one_foot.feed_forward)
    assert not both[: len(plain)].any()
    assert joined([plain, plain]).torques is None


def test_postures_on_one_foot_keep_their_margins_and_show_26_parameters(robot, one_foot, with_one_foot):
    one = with_one_foot.take(with_one_foot.support == "right")
    margins = single_support_margins(one_foot, one.joint_angles, one.swing_pose)
    assert min(values.min() for values in margins.values()) >= 0
    assert set(margins) >= {"stability margin", "torques", "swing foot lifted", "cell load"}
    said: Any = describe_plan(robot, with_one_foot, "plan", "wii")
    assert len(said.predicted_standard_error_mm) == 26
    assert said.margins["right foot: stability margin"]["value"] >= 0
    found = measured(robot, with_one_foot)
    assert "right" in set(found.support)
    assert len(identify(found, robot).full.value) == 26


def test_a_lifted_foot_does_not_drift(robot, nominal, with_one_foot):
    findings = {f.name: f for f in preflight(measured(robot, with_one_foot), nominal)}
    assert findings["drift"].result == "pass"
