"""Optimal postures, held against independent code, and what a plan holds beside them: repeats, one foot."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.effect_changes import measured
from tests.posed import check_standing
from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.described_plan import describe_plan
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, joined
from tulip_testbed.identification.planning.blocks import information, information_slope
from tulip_testbed.identification.planning.constraints import evaluate
from tulip_testbed.identification.planning.footing import footing
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
from tulip_testbed.identification.planning.search import design_of, repair_start, search
from tulip_testbed.identification.planning_ranges import planning_ranges
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan

STEP = 1e-6
SIGMA = 4.16e-3
OPTIMAL = DEFAULT_PLAN.parent / "optimal"


@pytest.fixture(scope="module")
def problem(robot, plate):
    return planning_problem(robot, plate)


@pytest.fixture(scope="module")
def small(problem):
    """Five placements of three postures, as `tulip plan optimal --hops 1` makes them."""
    return SearchTask(problem, objectives(SIGMA)["condition"], 5, 3, 211, hops=1).run()


def differences(function, design):
    steps = STEP * np.eye(design.shape[1])
    return np.stack([(function(design + s) - function(design - s)) / (2 * STEP) for s in steps], axis=-1)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(row=st.integers(0, 149), noise=st.integers(0, 2**31))
def test_derivatives_through_the_inverse_kinematics(problem, plan, row, noise):
    angles = plan.joint_angles[row : row + 1]
    bent = np.array([problem.parameters.tree.joints.index(f"{side}_knee") for side in ("right", "left")])
    if angles[0, bent].min() < 0.2:  # near a straight knee differences lose digits; plans keep away
        return
    design = design_of(problem, angles, plan.swing_pose[row : row + 1])
    design = design + 1e-3 * np.random.default_rng(noise).standard_normal(design.shape)
    found = evaluate(problem, design, angles)
    slopes = differences(lambda u: evaluate(problem, u, angles).inequalities, design)
    smooth = np.abs(found.inequalities)[0] < 50  # not the corners off the hull, which begin no edge
    smooth &= np.array(found.names) != "link clearance"  # exact to 1e-10 m: larger steps there
    scale = np.maximum(np.abs(found.inequality_jacobian[0]).max(axis=1, keepdims=True), 1.0)
    assert np.abs((slopes - found.inequality_jacobian)[0] / scale)[smooth].max() < 1e-6
    regressor = differences(lambda u: evaluate(problem, u, angles).regressor, design)
    assert np.abs(regressor - found.regressor_slopes).max() < 1e-6 * np.abs(found.regressor_slopes).max()


@pytest.mark.parametrize("name", objectives(1.0))
def test_derivatives_of_the_objectives(problem, plan, name):
    rows = plan.placement <= 10
    angles, swing = plan.joint_angles[rows], plan.swing_pose[rows]
    found = evaluate(problem, design_of(problem, angles, swing), angles)
    rng = np.random.default_rng(5)
    way = rng.standard_normal(found.regressor.shape)
    for smooth in objectives(SIGMA)[name].smooth:

        def along(t, smooth=smooth):
            regressor = found.regressor + t * way
            return smooth(information(dataclasses.replace(found, regressor=regressor)))[0]

        _, by_matrix = smooth(information(found))
        exact = (2 * found.regressor @ by_matrix * way).sum()
        numeric = (along(1e-6) - along(-1e-6)) / 2e-6
        assert numeric == pytest.approx(exact, rel=1e-4, abs=1e-7)
        assert information_slope(found, by_matrix).shape == (50, 9)


def test_small_plan_improves_and_keeps_every_constraint(problem, small, robot):
    """Recomputed from joint angles through MuJoCo and the random search's own geometry."""
    assert small.made["final_objective"] < 0.6 * small.made["initial_objective"]
    check_standing(robot, small)
    margins = smallest_margins(problem, small)
    assert all(margin["value"] > -1e-6 for margin in margins.values())
    assert set(margins) >= {"stability margin", "cell load", "torques", "joint limits"}


def test_objective_is_recomputed_from_the_plan_file(tmp_path, robot, model, parameters, small):
    write_plan(tmp_path / "plan", small)
    again = read_plan(tmp_path / "plan", robot)
    found = np.linalg.cond(stacked_regressor(parameters, again.joint_angles))
    assert found == pytest.approx(small.made["final_objective"], rel=1e-8)
    assert again.feed_forward.tobytes() == small.feed_forward.tobytes()
    assert again.feed_forward.any()


def held_without_sag(rig, plan):
    """Return equilibria in the laboratory's own scene, without friction and noise, at the plan's angles."""
    held = solve_plan(rig, plan).reference
    assert held.solved.all()
    assert np.abs(held.state.angles[:, : plan.joint_angles.shape[1]] - plan.joint_angles).max() < 1e-4
    return held


def test_feed_forward_shares_the_load_as_planned(problem, small, rig):
    held = held_without_sag(rig, small)
    design = design_of(problem, small.joint_angles, small.swing_pose)
    foot = footing(problem, np.column_stack([design[:, [0, 1, 6, 7, 8]], np.zeros((len(small), 3))]))
    wrench = held.state.wrench  # of the floor on either sole, about the sole points
    assert np.abs(wrench[:, :, 2] - foot.feet).max() < 0.1
    assert np.abs(wrench[:, :, :2]).max() < 0.5
    sagging = solve_plan(rig, dataclasses.replace(small, torques=None)).reference
    assert np.abs(sagging.state.wrench[:, :, 2] - foot.feet).max() > 5


@pytest.mark.slow
def test_optimal_postures_stand_in_the_full_dynamics(robot, model):
    plan = read_plan(OPTIMAL, robot)
    rig = preset_rig("wii", robot)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    done = run_dynamics(rig, plan.take(np.isin(plan.placement, (2, 12, 22))), 214)
    assert len(done.truth.dropped) <= 1


def test_chance_margin_covers_robots_that_differ(problem, plan):
    """The linear s.d. of the CoM against robots drawn around the nominal one."""
    from tulip_testbed.sim.random_robots import draw_robot

    model, rng = problem.robot.model, np.random.default_rng(212)
    rows = problem.parameters.regressor(plan.joint_angles[:5])
    drawn = np.array([rows @ problem.parameters.values(draw_robot(model, 0.1, rng)) for _ in range(400)])
    predicted = np.sqrt(np.einsum("mip,pq,miq->mi", rows, problem.parameter_covariance, rows))
    assert drawn.std(axis=0) == pytest.approx(predicted, rel=0.15)


def test_what_cannot_be_repaired_is_refused_with_its_reason(robot, plate, plan):
    ranges = dataclasses.replace(planning_ranges(robot), least_cell_load=60.0)
    problem = planning_problem(robot, plate, ranges)
    goal = objectives(SIGMA)["condition"]
    with pytest.raises(InputError, match=r"cannot be repaired .* expected 1 that can; blocked by cell load"):
        repair_start(problem, goal, plan.take(np.arange(5)), 5, 1, "ranges")


SEED = 311


@pytest.fixture(scope="module")
def one_foot(robot, plate):
    return planning_problem(robot, plate, support="right")


@pytest.fixture(scope="module")
def with_one_foot(one_foot, few):
    """Six postures on the stance foot after forty on both."""
    swing = few.swing_pose[-1]
    angles = feasible_pool(one_foot, swing, 6, np.random.default_rng(SEED), times=1)[:6]
    return appended_on_one_foot(few, OnOneFoot("right", one_foot, swing, angles))


@pytest.mark.slow
def test_the_next_placements_tell_more_than_random_ones(problem, robot, plate, plan):
    taken = measured(robot, plan.take(plan.placement <= 10), "wii", seed=SEED)
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


def test_repeats_stand_in_the_plan_and_in_the_measurements(robot, few, tmp_path):
    plan = with_repeats(few, 7, SEED)
    within, anew = (plan.made["repeats"][key] for key in ("within_placement", "placed_anew"))
    assert (len(within), len(anew), len(plan), plan.postures) == (4, 3, len(few) + 7, len(few))
    for number in within + anew:
        first, second = np.flatnonzero(plan.posture == number)
        assert second > first + 1  # never at once
        np.testing.assert_array_equal(plan.joint_angles[first], plan.joint_angles[second])
        assert (plan.placement[first] == plan.placement[second]) == (number in within)
    write_plan(tmp_path / "plan", plan)
    again = read_plan(tmp_path / "plan", robot)
    held = measured(robot, again, "ideal", seed=SEED)
    assert len(held) <= len(plan)  # the laboratory adds none of its own
    assert set(held.posture.tolist()) <= set(plan.posture.tolist())
    pairs = [np.flatnonzero(held.posture == number) for number in anew]
    assert any(len(np.unique(held.placement[rows])) == 2 for rows in pairs)


def test_feed_forward_holds_postures_on_one_foot_without_sag(rig, with_one_foot):
    one = with_one_foot.take(with_one_foot.support == "right")
    held_without_sag(rig, one)
    sagging = solve_plan(rig, dataclasses.replace(one, torques=None)).reference
    assert np.abs(sagging.state.angles[:, : one.joint_angles.shape[1]] - one.joint_angles).max() > 0.01


def test_torques_go_with_their_postures(robot, model, with_one_foot, tmp_path):
    """Through repeats, parts, the file, and beside postures that have none."""
    torques = dict(zip(with_one_foot.posture.tolist(), with_one_foot.feed_forward, strict=True))
    plan = with_repeats(with_one_foot, 7, SEED)
    plan = plan.take(np.arange(len(plan))[::-1])
    write_plan(tmp_path / "plan", plan)
    again = read_plan(tmp_path / "plan", robot)
    np.testing.assert_array_equal(again.feed_forward, [torques[number] for number in again.posture.tolist()])
    one = with_one_foot.take(np.isin(with_one_foot.posture, with_one_foot.posture[-6:]))
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


def test_a_lifted_foot_does_not_drift(robot, nominal, with_one_foot):
    findings = {f.name: f for f in preflight(measured(robot, with_one_foot, "wii", seed=SEED), nominal)}
    assert findings["drift"].result == "pass"
