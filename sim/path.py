"""Paths between postures that keep both feet where they stand (a closed chain)."""

from __future__ import annotations

import mujoco
import numpy as np

from sim.model import Robot, between_feet, sole_point

NEWTON_STEPS = 8


def base_pose(model: mujoco.MjModel, robot: Robot, angles: np.ndarray) -> np.ndarray:
    """Pose of the free body that puts the stance sole on the origin, flat, (7,) [m, quaternion]."""
    data = mujoco.MjData(model)
    _put(model, data, angles, np.array([0.0, 0, 0, 1, 0, 0, 0]))
    foot = data.body(robot.stance_foot)
    inverse = np.zeros(4)
    mujoco.mju_negQuat(inverse, foot.xquat)
    sole = foot.xpos + foot.xmat.reshape(3, 3) @ sole_point(model, robot.stance_foot)
    position = np.zeros(3)
    mujoco.mju_rotVecQuat(position, -sole, inverse)
    return np.concatenate([position, inverse])


def closed_path(
    model: mujoco.MjModel, robot: Robot, start: np.ndarray, end: np.ndarray, steps: int
) -> np.ndarray:
    """Joint angles from `start` (excluded) to `end`, (steps, n) [rad].

    The torso goes straight at minimum jerk while the feet stay; so the load goes over from
    foot to foot without detours, as it would not on a line in joint space. Joints that are not
    between the feet go straight too; Newton's method finds the others' angles, nearest to the
    straight way where there is a choice.
    """
    s = np.arange(1, steps + 1) / steps
    s = s**3 * (10 - 15 * s + 6 * s**2)
    pose = [base_pose(model, robot, angles) for angles in (start, end)]
    turn = np.zeros(3)
    mujoco.mju_subQuat(turn, pose[1][3:], pose[0][3:])
    poses = np.tile(pose[0], (steps, 1))
    poses[:, :3] += s[:, None] * (pose[1][:3] - pose[0][:3])
    for row, part in zip(poses, s, strict=True):
        mujoco.mju_quatIntegrate(row[3:], turn, part)
    data, soles = mujoco.MjData(model), {foot: sole_point(model, foot) for foot in robot.feet}
    feet = []
    for angles, at in ((start, pose[0]), (end, pose[1])):
        _put(model, data, angles, at)
        feet.append(_foot_poses(data, soles))
    coupled = between_feet(model, robot)
    columns = 6 + np.flatnonzero(coupled)
    path = np.empty((steps, len(start)))
    for k, part in enumerate(s):
        angles = start + part * (end - start)
        # The two ends' feet differ by the plan's rounding only; go over from one to the other.
        wanted = [a + part * (b - a) for a, b in zip(*feet, strict=True)]
        for _ in range(NEWTON_STEPS):
            _put(model, data, angles, poses[k])
            error, jacobian = _foot_errors(model, data, soles, wanted)
            if np.abs(error).max() < 1e-8:
                break
            angles[coupled] -= np.linalg.lstsq(jacobian[:, columns], error, rcond=1e-6)[0]
        path[k] = angles
    path[-1] = end
    return path


def _put(model: mujoco.MjModel, data: mujoco.MjData, angles: np.ndarray, pose: np.ndarray) -> None:
    """The free body comes first in `qpos`, then the hinges in order."""
    data.qpos[:7], data.qpos[7:] = pose, angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def _foot_poses(data: mujoco.MjData, soles: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Position and rotation of each sole side by side, (3, 4)."""
    poses = []
    for foot, point in soles.items():
        position, rotation = data.body(foot).xpos, data.body(foot).xmat.reshape(3, 3)
        poses.append(np.column_stack([position + rotation @ point, rotation]))
    return poses


def _foot_errors(
    model: mujoco.MjModel, data: mujoco.MjData, soles: dict[str, np.ndarray], wanted: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """How far both soles are from where they should be (12,), and its Jacobian (12, nv)."""
    errors, jacobians = [], []
    for foot, actual, target in zip(soles, _foot_poses(data, soles), wanted, strict=True):
        r = actual[:, 1:] @ target[:, 1:].T
        errors += [actual[:, 0] - target[:, 0]]
        errors += [np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2]
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], actual[:, 0], model.body(foot).id)
        jacobians.append(jacobian)
    return np.concatenate(errors), np.vstack(jacobians)
