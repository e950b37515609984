"""The torques that hold a robot on one foot, by MuJoCo's inverse dynamics: what plans are compared with."""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.robot import Robot


def holding_torques(robot: Robot, model: mujoco.MjModel, angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Compute the torques that hold the robot on its stance foot, (n_joints,) [N m].

    Args:
        point: centre of pressure, (2,) [m]; below the centre of mass.
    """
    data = mujoco.MjData(model)
    chain = ClosedChain(model, robot)
    data.qpos[:7], data.qpos[chain.qpos] = chain.base_pose(angles), angles
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, np.append(point, 0.0), model.body(robot.stance_foot).id)
    weight = -model.opt.gravity * model.body_subtreemass[0]
    return (data.qfrc_bias - jacobian.T @ weight)[chain.dofs]
