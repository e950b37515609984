"""Loads of the nominal robot in motion: torques of the drives, zero-moment point, loads of the feet."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.identification.feasibility import planned_foot_loads
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.robot import Robot, sole_corners

BREAKING_LOOSE = 0.01  # rad/s, speed from which dry friction acts in full


@dataclass(frozen=True)
class MotionLoads:
    """Loads at k instants of a motion, in the base frame.

    Attributes:
        torques: what the drives exert on the joints, dry friction left out, (k, n) [N m].
        friction: dry friction of the drives against the motion, (k, n) [N m].
        com: projection of the centre of mass, (k, 2) [m].
        zmp: zero-moment point of the ground's force on both feet together, (k, 2) [m].
        foot_wrenches: of the ground on right and left foot, about the origin, (k, 2, 6) [N, N m].
        foot_points: the load's point on each foot, (k, 2, 2) [m]; not a number for a foot in the air.
        soles: corners of the right and the left sole over the ground, (k, 2, 4, 3) [m].
    """

    torques: np.ndarray
    friction: np.ndarray
    com: np.ndarray
    zmp: np.ndarray
    foot_wrenches: np.ndarray
    foot_points: np.ndarray
    soles: np.ndarray


class LoadsInMotion(ClosedChain):
    """Inverse dynamics of a robot by MuJoCo."""

    def __init__(self, robot: Robot):
        super().__init__(robot.model, robot)
        self.corners = [sole_corners(robot.model, foot) for foot in robot.feet]

    def at(self, times: np.ndarray, joint_angles: np.ndarray, support: str) -> MotionLoads:
        """Compute the loads of a motion by differences in time.

        The load is shared between two feet as a plan's feed-forward does it (`planned_foot_loads`), with the
        zero-moment point in place of the centre of mass; horizontal forces are shared alike.

        Args:
            times: instants at equal distances, (k,) [s]. joint_angles: (k, n) [rad].
            support: "double", "right" or "left".
        """
        model, data, base = self.model, self.data, int(support == "left")
        poses = np.array([self.position(angles, base) for angles in joint_angles])
        speeds, accelerations = self.derivatives(times, poses)
        count, joints = joint_angles.shape
        torques, com = np.empty((count, joints)), np.empty((count, 2))
        totals, soles = np.empty((count, 6)), np.empty((count, 2, 4, 3))
        jacobians = np.empty((count, 2, 6, model.nv))
        forces = np.zeros(model.nv)
        for k in range(count):
            data.qpos, data.qvel, data.qacc = poses[k], speeds[k], accelerations[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 1, forces)
            forces += model.dof_armature * data.qacc + model.dof_damping * data.qvel
            torques[k], com[k] = forces[self.dofs], data.subtree_com[0, :2]
            turned = np.zeros(3)
            mujoco.mju_rotVecQuat(turned, forces[3:6], data.qpos[3:7])
            totals[k] = [*forces[:3], *(np.cross(data.qpos[:3], forces[:3]) + turned)]
            for side, foot in enumerate(self.feet):
                soles[k, side] = self.corners[side] @ data.xmat[foot].reshape(3, 3).T + data.xpos[foot]
                jacobian = jacobians[k, side]
                mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], np.zeros(3), foot)
        zmp = np.column_stack([-totals[:, 4], totals[:, 3]]) / totals[:, 2, None]
        if support == "double":
            loads, points = planned_foot_loads(1.0, zmp, *soles[..., :2].mean(axis=2).swapaxes(0, 1))
        else:
            loads = np.tile([support == "right", support == "left"], (count, 1)).astype(float)
            points = np.where(loads[..., None] > 0, zmp[:, None], np.nan)
        wrenches = loads[..., None] * totals[:, None]
        wrenches[..., 3] = wrenches[..., 2] * np.nan_to_num(points[..., 1])
        wrenches[..., 4] = -wrenches[..., 2] * np.nan_to_num(points[..., 0])
        torques -= np.einsum("ksia,ksi->ka", jacobians[..., self.dofs], wrenches)
        friction = model.dof_frictionloss[self.dofs] * np.tanh(speeds[:, self.dofs] / BREAKING_LOOSE)
        return MotionLoads(torques, friction, com, zmp, wrenches, points, soles)

    def position(self, angles: np.ndarray, base: int) -> np.ndarray:
        """Return MuJoCo's coordinates with the sole of foot `base` flat on the origin, (nq,)."""
        position = np.zeros(self.model.nq)
        position[:7], position[self.qpos] = self.base_pose(angles, base), angles
        return position

    def height(self, position: np.ndarray) -> float:
        """Return the height of the centre of mass over the ground at MuJoCo's coordinates [m]."""
        self.data.qpos = position
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return float(self.data.subtree_com[0, 2])

    def derivatives(self, times: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate MuJoCo's coordinates twice by central differences, at rest at both ends, (k, nv)."""
        step, count = times[1] - times[0], len(times)
        # The motion begins and ends at rest: mirrored at its ends it goes on smoothly.
        padded = np.concatenate([poses[1:2], poses, poses[-2:-1]])
        between = np.empty((count + 1, self.model.nv))
        for k in range(count + 1):
            mujoco.mj_differentiatePos(self.model, between[k], step, padded[k], padded[k + 1])
        return (between[1:] + between[:-1]) / 2, np.diff(between, axis=0) / step
