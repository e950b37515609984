"""A robot in a posture, by MuJoCo's kinematics alone."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from tulip_testbed.sim.robot import joint_names


def posed(model: mujoco.MjModel, angles: ArrayLike, joints: Sequence[str] = ()) -> mujoco.MjData:
    """Turn joints, all of the model unless some are named [rad]; a free body lies in the world's axes."""
    data = mujoco.MjData(model)
    data.qpos[[int(model.joint(name).qposadr[0]) for name in joints or joint_names(model)]] = angles
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def seen_from(data: mujoco.MjData, body: str, point: np.ndarray) -> np.ndarray:
    """Return a point of the world in the frame of a body, (3,) [m]."""
    frame = data.body(body)
    return frame.xmat.reshape(3, 3).T @ (point - frame.xpos)
