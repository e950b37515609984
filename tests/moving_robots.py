"""Robots that move on a foot, by MuJoCo's inverse dynamics."""

import copy
import dataclasses
from typing import Any

import mujoco
import numpy as np

import tulip_testbed as tt
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements.contacts import WRENCH, Contacts
from tulip_testbed.sim.random_robots import draw_robot

GRAVITY = 9.81


def random_robot(robot, rng, spread=0.3):
    """A robot with other masses, centres and inertias, whose principal axes are turned."""
    model = copy.copy(robot.model)
    standard = draw_robot(model, spread, rng)
    has_mass = standard[:, 0] > 0
    model.body_mass[1:] = standard[:, 0]
    model.body_ipos[1:][has_mass] = standard[has_mass, 1:] / standard[has_mass, :1]
    turn = rng.standard_normal((model.nbody - 1, 4))
    model.body_iquat[1:] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return dataclasses.replace(robot, model=model)


def moving(robot, rng, count=6) -> Any:
    joints = nominal_robot(robot).parameters.tree.joints
    contacts = Contacts(
        "foot", WRENCH, np.zeros((2, 6)), None, np.zeros((2, 6)), np.zeros((2, 4)), np.zeros((2, 4))
    )
    header = tt.MeasurementHeader(
        robot={},
        joints=joints,
        cells=np.zeros((2, 0, 2)),
        top_height=np.zeros(2),
        gravity=GRAVITY,
        sensors=tt.SensorSheet(),
        contacts=contacts,
    )
    rows = {
        name: scale * rng.standard_normal((count, len(joints)))
        for name, scale in (("joint_angles", 0.4), ("joint_rates", 1.0), ("joint_accelerations", 5.0))
    }
    return tt.Measurements.from_arrays(
        header,
        placement=np.ones(count, int),
        wrenches=np.zeros((count, 2, 6)),
        support=np.array(["double", "right", "left"] * count)[:count],
        **rows,
    )


def by_inverse_dynamics(robot, foot, sole, angles, rates, accelerations, gravity=(0, 0, -GRAVITY)):
    """MuJoCo's free robot, whose root moves so that the foot rests at the origin.

    Args:
        gravity: in the foot's axes, (3,) [m/s2].

    Returns:
        the wrench (6,), axes (3, 3) and place (3,) of the free body, and the joints' torques without their
        armature, damping and friction, (n_joints,).
    """
    model = copy.copy(robot.model)
    model.opt.gravity = gravity
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_armature[:], model.dof_damping[:] = 0.0, 0.0
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
    wrench = np.concatenate([force, root + np.cross(data.xpos[1], force)])
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
    about_foot = np.append(force, wrench[3:] - np.cross(data.xpos[body], force))
    torques = data.qfrc_inverse[dofs] - jacobian[:, dofs].T @ about_foot
    return wrench, data.xmat[1].reshape(3, 3).copy(), data.xpos[1].copy(), torques
