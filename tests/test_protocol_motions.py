"""The order of a protocol and the motions between its postures."""

import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import yaml

import tulip_testbed as tt
from tulip_testbed.experiments.protocols.measuring_order import (
    drift_inflation,
    order_of_placements,
    shortest_path,
    shortest_tour,
)
from tulip_testbed.experiments.protocols.motion import FREE, HOIST, LIFT, MotionPlanner
from tulip_testbed.experiments.protocols.motion_loads import LoadsInMotion
from tulip_testbed.experiments.protocols.protocol_run import protocol_of
from tulip_testbed.identification.feasibility import stability_margin, support_polygon
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.planning_ranges import planning_ranges
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.robot import joint_ranges


def at_rest(angles):
    """Return instants and joint angles of a robot that keeps a posture."""
    return np.arange(3.0), np.tile(angles, (3, 1))


@pytest.mark.parametrize("name", ["optimal", "mixed"])
def test_torques_at_rest_are_the_plan_s(robot, name):
    """Which planning computed from its own kinematics."""
    plan, loads = getattr(tt.plans, name), LoadsInMotion(robot)
    for k in range(0, len(plan), 7):
        found = loads.at(*at_rest(plan.joint_angles[k]), str(plan.support[k]))
        np.testing.assert_allclose(found.torques[1], plan.torques[k], atol=1e-6)
        np.testing.assert_allclose(found.zmp[1], found.com[1], atol=1e-9)


def test_feet_and_drives_carry_the_motion(robot, small_protocol):
    """Applied to the free robot, torques and feet's wrenches give the motion's accelerations."""
    motion = next(m for m in small_protocol.motions if m and np.ptp(m.angles, axis=0).max() > 0.3)
    loads = LoadsInMotion(robot)
    found = loads.at(motion.times / 3, motion.angles, "double")
    speeds, accelerations = loads.derivatives(
        motion.times / 3, np.array([loads.position(q, 0) for q in motion.angles])
    )
    model, data = robot.model, mujoco.MjData(robot.model)
    k = len(motion.times) // 3
    data.qpos, data.qvel = loads.position(motion.angles[k], 0), speeds[k]
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    total, jacobian = np.zeros(model.nv), np.zeros((6, model.nv))
    total[loads.dofs] = found.torques[k]
    for side, foot in enumerate(loads.feet):
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], np.zeros(3), foot)
        total += jacobian.T @ found.foot_wrenches[k, side]
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    left = inertia @ accelerations[k] + data.qfrc_bias + model.dof_damping * speeds[k]
    np.testing.assert_allclose(total, left, atol=1e-6)


def test_every_motion_keeps_every_limit(robot, small_protocol):
    """Looked at anew: ranges, speed, torque, feet, centre of mass."""
    nominal, chain = nominal_robot(robot), MotionPlanner(robot, small_protocol.plan).loads
    ranges, torques = joint_ranges(robot.model), torque_limits(robot)
    inside = planning_ranges(robot).stability_margin
    motions = [m for m in small_protocol.motions if m]
    assert len(motions) > 10
    assert any(m.via_stance for m in motions)
    for motion in motions:
        assert motion.kind == FREE
        assert min(motion.room.values()) >= 0
        assert (motion.angles >= ranges[:, 0] - 1e-4).all()
        assert (motion.angles <= ranges[:, 1] + 1e-4).all()
        assert np.abs(motion.speeds).max() <= 0.5 * 1.01
        assert (np.abs(motion.torques) <= torques).all()
        swing = np.array([chain.swing_pose(q) for q in motion.angles])
        assert np.ptp(swing, axis=0).max() < 1e-4
        polygon = support_polygon(nominal.soles_in_base(motion.angles[:1])[0])
        assert stability_margin(nominal.center_of_mass(motion.angles), polygon) >= inside - 2e-4


def test_motions_begin_and_end_at_rest_in_their_postures(small_protocol):
    for k, motion in enumerate(small_protocol.motions):
        if motion is None:
            continue
        np.testing.assert_allclose(
            motion.angles[[0, -1]], small_protocol.plan.joint_angles[[k - 1, k]], atol=1e-9
        )
        assert np.abs(motion.speeds[[0, -1]]).max() < 1e-9
        slope = np.gradient(motion.angles, motion.times, axis=0)
        np.testing.assert_allclose(motion.speeds[2:-2], slope[2:-2], atol=0.02)
        assert (np.diff(motion.times) > 0).all()


def test_a_posture_that_asks_too_much_is_reached_in_the_hoist(robot):
    """Posture 25 of the random plan needs more than its drives give, if the load is shared as planned."""
    plan = tt.plans.random
    planner = MotionPlanner(robot, plan)
    over = [
        k
        for k in range(60)
        if planner.dynamic_room(*at_rest(plan.joint_angles[k]), "double")["torque"] < -0.05
        and plan.placement[k] == plan.placement[k - 1]
    ]
    motion = MotionPlanner(robot, plan).motion(over[0] - 1, over[0])
    assert motion.kind == HOIST
    assert "torque" in motion.reason
    assert "torque." not in motion.csv(plan.joints).splitlines()[0]
    assert yaml.safe_load(motion.yaml(plan.joints))["points"][0]["effort"] == []


def test_motions_on_one_foot_keep_the_other_in_the_air(robot):
    """Near each other: from a posture on the right foot to one with a little of the way to the next."""
    mixed = tt.plans.mixed
    plan = mixed.take(np.flatnonzero(mixed.support == "right")[[0, 0]])
    turned = plan.joint_angles + np.array([[0.0], [0.05]]) * np.eye(12)[6]  # the left hip's yaw
    plan = replace(plan, joint_angles=turned, posture=np.array([1, 2]), placement=np.array([1, 1]))
    motion = MotionPlanner(robot, plan).motion(0, 1)
    assert motion.kind == FREE
    found = LoadsInMotion(robot).at(motion.times, motion.angles, "right")
    assert found.soles[:, 1, :, 2].min() > 0.01
    assert np.isnan(found.foot_points[:, 1]).all()
    assert (found.foot_wrenches[:, 1] == 0).all()


def test_where_links_would_touch_the_robot_is_lifted(robot, small_plan, monkeypatch):
    """And what follows has a placement of its own, since its boards are recorded anew."""
    legs = MotionPlanner._legs
    monkeypatch.setattr(MotionPlanner, "_legs", lambda self, a, b: (legs(self, a, b)[0], LIFT))
    few = small_plan.take(np.arange(6))
    lifted = protocol_of(robot, few, repeats=0)
    assert lifted.motions == (None,) * len(few)
    assert len(lifted.placements) == len(few)
    assert sorted(lifted.plan.posture.tolist()) == sorted(few.posture.tolist())


def test_order_is_as_short_as_the_shortest():
    rng = np.random.default_rng(5)
    for count in (3, 5, 6):
        points = rng.random((count, 3))
        cost = np.linalg.norm(points[:, None] - points, axis=-1)

        def length(order, cost=cost):
            return cost[list(order[:-1]), list(order[1:])].sum()

        every = list(itertools.permutations(range(count)))
        assert length(shortest_path(cost)) == pytest.approx(min(map(length, every)))
        closed = min(length((*order, order[0])) for order in every)
        tour = shortest_tour(cost)
        assert length([*tour, tour[0]]) == pytest.approx(closed)


def test_everything_is_measured_once_and_repeats_are_spread(small_protocol, small_plan):
    plan = small_protocol.plan
    assert sorted(set(plan.posture.tolist())) == sorted(small_plan.posture.tolist())
    assert len(plan) == len(small_plan) + 3
    changes = np.count_nonzero(np.diff(plan.placement)) + 1
    assert changes == len(np.unique(plan.placement))
    for number in np.unique(plan.posture):
        rows = np.flatnonzero(plan.posture == number)
        assert (np.diff(rows) > 1).all()
        assert (plan.joint_angles[rows] == plan.joint_angles[rows[0]]).all()
    again = [n for n in small_protocol.placements if n > small_plan.placement.max()]
    assert again  # boards are laid anew
    assert all(
        motion is None
        for k, motion in enumerate(small_protocol.motions)
        if not k or plan.placement[k] != plan.placement[k - 1]
    )


def test_time_grows_with_nothing_else(robot):
    """A plan whose placements are sorted by the place of the foot confuses a drift; the order does not."""
    plan = tt.plans.random.take(tt.plans.random.placement <= 12)
    first = plan.swing_pose[np.searchsorted(plan.placement, plan.placement)][:, 0]
    plan = plan.take(np.argsort(first, kind="stable"))
    order = order_of_placements(robot, plan)
    ordered = plan.take(np.concatenate([np.flatnonzero(plan.placement == number) for number in order]))
    assert drift_inflation(robot, ordered) < 0.8 * drift_inflation(robot, plan)


@pytest.mark.parametrize("rows", [1, 5])
def test_a_short_plan_that_alone_tells_nothing_has_a_protocol(robot, small_plan, rows):
    """Such as the next experiment of a session."""
    small_protocol = protocol_of(robot, small_plan.take(np.arange(rows)))
    assert sorted(set(small_protocol.plan.posture.tolist())) == list(range(1, rows + 1))
    assert len(small_protocol.plan) == rows + rows // 5
    assert "Protocol" in repr(small_protocol)
