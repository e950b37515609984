"""Plans of mixed support: what every row keeps, by independent routes, and what the search gains."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.posed import holding_torques, posed, seen_from
from tests.test_link_clearances import Collisions
from tulip_testbed import plans
from tulip_testbed.experiments.described_plan import describe_plan
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.parameter_tables import read_reported
from tulip_testbed.identification.base_parameters import base_parameters, common_support
from tulip_testbed.identification.planning.objectives import objectives
from tulip_testbed.identification.planning.one_foot import (
    evaluate_one_foot,
    from_other_foot,
    with_feet_exchanged,
)
from tulip_testbed.identification.planning.one_foot_search import (
    board_pose,
    feasible_pool,
    from_pools,
    random_pools,
)
from tulip_testbed.identification.planning.optimal_plan import SearchTask, measured_information
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning_ranges import planning_ranges
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.robot import sole_corners, sole_point

SEED = 331
COUNTS = {"right": 4, "left": 4}
PER, PLACEMENTS = 3, 3
# The joints of a hip lie at one place, so that these links are neighbours and may touch.
HIPS = [{"torso", f"{side}_hip_yaw", f"{side}_hip", f"{side}_upper_leg"} for side in ("right", "left")]


@pytest.fixture(scope="module")
def problem(robot, plate):
    return planning_problem(robot, plate, support="mixed")


@pytest.fixture(scope="module")
def goal(problem):
    return objectives(4.16e-3)["d-optimal"]


@pytest.fixture(scope="module")
def mixed(problem, goal):
    """Nine postures on both feet and four on each foot."""
    return SearchTask(problem, goal, PLACEMENTS, PER, SEED, hops=0, counts=COUNTS).run()


def criterion(problem, plan):
    rows = problem.parameters.regressor(plan.joint_angles, plan.support).reshape(-1, len(problem.value))
    return objectives(4.16e-3)["d-optimal"].value(rows.T @ rows)


def test_derivatives_on_either_foot_are_central_differences(problem):
    """Along three directions in which all joints move, of a few random feasible postures on each foot."""
    step, rng = 1e-6, np.random.default_rng(308)
    for own in (problem, from_other_foot(problem)):
        place = board_pose(own)
        angles = feasible_pool(own, place, 2, np.random.default_rng(SEED), 2)
        swing = np.tile(place, (len(angles), 1))
        found = evaluate_one_foot(own, angles, swing)
        for along in rng.choice([-1.0, 1.0], (3, angles.shape[1])):
            ahead, back = (evaluate_one_foot(own, angles + s * step * along, swing) for s in (1, -1))
            slope = (ahead.regressor - back.regressor) / (2 * step)
            expected = np.einsum("minp,n->mip", found.regressor_slopes, along)
            np.testing.assert_allclose(expected, slope, atol=1e-7)
            slope = (ahead.inequalities - back.inequalities) / (2 * step)
            np.testing.assert_allclose(found.inequality_jacobian @ along, slope, atol=5e-3)


@pytest.mark.slow
def test_rows_on_either_foot_stand_by_mujoco(robot, mixed):
    """CoM over the carrying sole, other foot and links off the ground, drives within their limits."""
    model, ranges = robot.model, planning_ranges(robot)
    low_high = np.array([model.joint(name).range for name in mixed.joints])
    for support, own in (("right", robot), ("left", with_feet_exchanged(robot))):
        rows = np.flatnonzero(mixed.support == support)
        assert len(rows) == COUNTS[support]
        sole = sole_corners(model, own.stance_foot)[:, :2]
        collisions, limits = Collisions(own), torque_limits(robot)
        for row in rows:
            angles = mixed.joint_angles[row]
            data, point = posed(model, angles, mixed.joints), sole_point(model, own.stance_foot)
            com = seen_from(data, own.stance_foot, data.subtree_com[1]) - point
            room = np.minimum(com[:2] - sole.min(axis=0), sole.max(axis=0) - com[:2])
            assert room.min() > ranges.stability_margin
            foot, lifted = (data.body(name) for name in own.feet)
            corners = sole_corners(model, own.swing_foot) @ lifted.xmat.reshape(3, 3).T + lifted.xpos
            assert ((corners - foot.xpos) @ foot.xmat.reshape(3, 3) - point)[:, 2].min() > 0.0199
            assert (angles > low_high[:, 0]).all()
            assert (angles < low_high[:, 1]).all()
            depths = collisions.at(angles)
            assert not {pair for pair in depths if not any(pair <= hip for hip in HIPS)}
            expected = holding_torques(own, model, angles, com[:2])
            np.testing.assert_allclose(mixed.feed_forward[row], expected, atol=1e-9)
            assert (np.abs(expected) < 0.851 * limits).all()


@pytest.mark.slow
def test_the_search_beats_the_best_of_a_random_pool(problem, goal, mixed):
    """With the same numbers and the same postures on both feet, and a pool twice as large as the start's."""
    pools = [*random_pools(problem, COUNTS, SEED + 1, 6)]
    both = problem.parameters.regressor(mixed.joint_angles[mixed.support == "double"])
    chosen = from_pools(pools, COUNTS, np.einsum("mip,miq->pq", both, both), goal.smooth[-1])
    angles = mixed.joint_angles.copy()
    for one in chosen:
        angles[mixed.support == one.support] = one.angles
    pool = criterion(problem, dataclasses.replace(mixed, joint_angles=angles))
    found = criterion(problem, mixed)
    assert found < pool - 0.3  # of twice the logarithm of a standard error: 14 % less
    assert found == pytest.approx(mixed.made["final_objective"], rel=1e-9)
    assert found < mixed.made["initial_objective"] - 0.5


def test_the_shipped_plan_promises_a_third_of_the_papers_errors(robot):
    plan = plans.mixed
    counts = {support: int((plan.support == support).sum()) for support in ("double", "right", "left")}
    assert counts == {"double": 20, "right": 44, "left": 44}
    single = plan.placement[plan.support != "double"]  # each posture has a placement of its own
    assert len(np.unique(single)) == len(single)
    said: Any = describe_plan(robot, plan, "plan", "wii")
    names = base_parameters(robot, support="mixed").names
    reported: Any = read_reported(robot)
    columns = ("full_mm", "full_rel_se_percent")
    table = np.array([[one[each] for each in columns] for one in reported.parameters.values()], float)
    rows = [names.index(name) for name in base_parameters(robot).names]
    share = said.predicted_standard_error_mm[rows] / (np.abs(table).prod(axis=1) / 100)
    assert np.median(share) < 0.2
    assert share.max() < 0.8
    assert min(margin["value"] for margin in said.margins.values()) > -1e-6
    np.testing.assert_allclose(
        plan.made["described"]["predicted_standard_error_mm"], said.predicted_standard_error_mm, rtol=1e-6
    )


def test_measurements_on_either_foot_are_known_to_the_next_plan(robot, plate):
    """Rows on one foot tell other parameters than rows on both: together all 27."""
    measured = Laboratory(robot, "ideal").run(plans.mixed, 1, "statics").measurements
    support = common_support(measured.support)
    known = measured_information(planning_problem(robot, plate, support=support), measured)
    assert known.shape == (27, 27)
    assert np.linalg.matrix_rank(known) == 27
