"""A robot in a posture, how it stands on its soles, and the torques that hold it, by MuJoCo alone."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from tulip_testbed.identification.feasibility import place_polygon, stability_margin, support_polygon
from tulip_testbed.identification.planning_ranges import planning_ranges
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.robot import Robot, joint_names, sole_corners


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


def check_standing(robot: Robot, plan: PosturePlan) -> None:
    """Check that postures stand flat on both soles where the plan says, within its ranges."""
    model, ranges, (stance, swing) = robot.model, planning_ranges(robot), robot.feet
    low, high = np.array([model.joint(name).range for name in plan.joints]).T
    assert ((plan.joint_angles >= low) & (plan.joint_angles <= high)).all()
    for axis, (least, most) in enumerate((ranges.swing_x, ranges.swing_y, ranges.swing_yaw)):
        assert plan.swing_pose[:, axis].min() >= least - 1e-9
        assert plan.swing_pose[:, axis].max() <= most + 1e-9
    corners = np.array([sole_corners(model, foot) for foot in robot.feet])
    soles, heights = corners[..., :2], corners[:, 0, 2]
    for angles, planned in zip(plan.joint_angles, plan.swing_pose, strict=True):
        data = posed(model, angles)
        offset = seen_from(data, stance, data.body(swing).xpos)
        turn = data.body(stance).xmat.reshape(3, 3).T @ data.body(swing).xmat.reshape(3, 3)
        pose = [*offset[:2], np.arctan2(turn[1, 0], turn[0, 0])]
        np.testing.assert_allclose(pose, planned, rtol=0, atol=1e-7)
        level = [heights[0] - heights[1], 0, 0, 1]
        np.testing.assert_allclose([offset[2], *turn[:, 2]], level, rtol=0, atol=1e-7)
        com = seen_from(data, stance, data.subtree_com[1])
        feet = [place_polygon(sole, at) for sole, at in zip(soles, (np.zeros(3), planned), strict=True)]
        margin = stability_margin(com[:2], support_polygon(np.array(feet)))
        assert margin > ranges.stability_margin - 1e-7
        torso = seen_from(data, stance, data.body(1).xpos)
        assert torso[2] - heights[0] > ranges.least_height - 1e-9


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
