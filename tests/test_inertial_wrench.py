"""The wrench that a moving robot needs: against MuJoCo's inverse dynamics and against rates of momentum."""

import copy
import dataclasses

import mujoco
import numpy as np
import pytest

from tulip_testbed.identification.inertial_wrench import needed_wrench
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.contacts import WRENCH, Contacts
from tulip_testbed.measurements.header import MeasurementHeader, SensorSheet
from tulip_testbed.sim.random_robots import draw_robot

GRAVITY = 9.81


def random_robot(robot, rng):
    """A robot with other masses, centres and inertias, whose principal axes are turned."""
    model = copy.copy(robot.model)
    standard = draw_robot(model, 0.3, rng)
    has_mass = standard[:, 0] > 0
    model.body_mass[1:] = standard[:, 0]
    model.body_ipos[1:][has_mass] = standard[has_mass, 1:] / standard[has_mass, :1]
    turn = rng.standard_normal((model.nbody - 1, 4))
    model.body_iquat[1:] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return dataclasses.replace(robot, model=model)


def moving(robot, rng, count=6) -> Measurements:
    joints = nominal_robot(robot).parameters.tree.joints
    contacts = Contacts(
        "foot", WRENCH, np.zeros((2, 6)), None, np.zeros((2, 6)), np.zeros((2, 4)), np.zeros((2, 4))
    )
    header = MeasurementHeader(
        robot={},
        joints=joints,
        cells=np.zeros((2, 0, 2)),
        top_height=np.zeros(2),
        gravity=GRAVITY,
        sensors=SensorSheet(),
        contacts=contacts,
    )
    rows = {
        name: scale * rng.standard_normal((count, len(joints)))
        for name, scale in (("joint_angles", 0.4), ("joint_rates", 1.0), ("joint_accelerations", 5.0))
    }
    return Measurements.from_arrays(
        header,
        placement=np.ones(count, int),
        wrenches=np.zeros((count, 2, 6)),
        support=np.array(["double", "right", "left"] * count)[:count],
        **rows,
    )


def by_inverse_dynamics(robot, foot, sole, angles, rates, accelerations):
    """MuJoCo's free robot, whose root moves so that the foot rests at the origin, (6,)."""
    model = copy.copy(robot.model)
    model.opt.gravity = 0, 0, -GRAVITY
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, body = mujoco.MjData(model), robot.model.body(foot).id
    names = nominal_robot(robot).parameters.tree.joints
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in names]
    places = [int(model.jnt_qposadr[model.joint(name).id]) for name in names]
    data.qpos[:7], data.qpos[places] = [0, 0, 0, 1, 0, 0, 0], angles
    mujoco.mj_forward(model, data)
    there = data.xmat[body].reshape(3, 3).T
    mujoco.mju_mat2Quat(data.qpos[3:7], there.ravel())
    data.qpos[:3] = -sole - there @ data.xpos[body]
    data.qvel[dofs] = rates
    jacobian, change = np.zeros((6, model.nv)), np.zeros((6, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
    data.qvel[:6] = -np.linalg.solve(jacobian[:, :6], jacobian[:, dofs] @ rates)
    mujoco.mj_forward(model, data)
    mujoco.mj_jacDot(model, data, change[:3], change[3:], data.xpos[body], body)
    data.qacc[:], data.qacc[dofs] = 0, accelerations
    data.qacc[:6] = -np.linalg.solve(jacobian[:, :6], jacobian[:, dofs] @ accelerations + change @ data.qvel)
    mujoco.mj_inverse(model, data)
    force = data.qfrc_inverse[:3]
    root = data.xmat[1].reshape(3, 3) @ data.qfrc_inverse[3:6]
    return np.concatenate([force, root + np.cross(data.xpos[1], force)])


@pytest.mark.parametrize("which", ["tulip", "humanoid"])
def test_it_is_what_inverse_dynamics_need(which, robot, foreign):
    rng = np.random.default_rng(210)
    for _ in range(3):
        one = random_robot(robot if which == "tulip" else foreign[which], rng)
        nominal, m = nominal_robot(one), moving(one, rng)
        found = needed_wrench(nominal, m)
        assert m.joint_rates is not None
        assert m.joint_accelerations is not None
        for row, support in enumerate(m.support):
            side = int(support == "left")
            foot = (one.stance_foot, one.swing_foot)[side]
            motion = m.joint_angles[row], m.joint_rates[row], m.joint_accelerations[row]
            expected = by_inverse_dynamics(one, foot, nominal.points[side], *motion)
            assert found[row] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_a_robot_at_rest_is_carried_under_its_centre_of_mass(nominal, robot):
    m = dataclasses.replace(
        moving(robot, np.random.default_rng(211)), joint_rates=None, joint_accelerations=None
    )
    wrench, weight = needed_wrench(nominal, m), nominal.mass * GRAVITY
    assert wrench[:, :3] == pytest.approx(np.tile([0, 0, weight], (len(m), 1)), abs=1e-9)
    point = np.column_stack([-wrench[:, 4], wrench[:, 3]]) / weight
    right = m.support != "left"
    center = nominal.geometry(m.joint_angles[right]).center[:, :2]
    assert point[right] == pytest.approx(center, abs=1e-12)


def test_the_force_is_the_rate_of_the_momentum(nominal, robot):
    """Along a motion the centre of mass accelerates by the force."""
    start = moving(robot, np.random.default_rng(212), 1)
    assert start.joint_rates is not None
    assert start.joint_accelerations is not None
    step = 1e-4
    time = step * np.arange(-2, 3)[:, None]
    angle, rate, faster = start.joint_angles, start.joint_rates, start.joint_accelerations
    m = dataclasses.replace(
        start.take(np.zeros(5, int)),
        joint_angles=angle + time * rate + time**2 / 2 * faster,
        joint_rates=rate + time * faster,
        joint_accelerations=np.repeat(faster, 5, axis=0),
    )
    center = nominal.geometry(m.joint_angles).center
    second = (-center[0] + 16 * center[1] - 30 * center[2] + 16 * center[3] - center[4]) / (12 * step**2)
    expected = nominal.mass * (second + np.array([0, 0, GRAVITY]))
    assert needed_wrench(nominal, m)[2, :3] == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
