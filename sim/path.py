"""Paths between postures that keep both feet in place (a closed kinematic chain)."""

from collections.abc import Callable

import mujoco
import numpy as np
import scipy

from tulip_testbed.sim.robot import Robot, between_feet, joint_names, sole_point

NEWTON_STEPS = 12
PATH_KNOTS = 30
TOLERANCE = 1e-8  # of the feet's poses [m, rad]


class ClosedChain:
    """The robot alone as a closed chain between its feet; a class because it keeps MuJoCo's data."""

    def __init__(self, model: mujoco.MjModel, robot: Robot):
        self.model, self.data = model, mujoco.MjData(model)
        names = joint_names(model)
        self.qpos = np.array([model.joint(name).qposadr[0] for name in names])
        self.dofs = np.array([model.joint(name).dofadr[0] for name in names])
        self.coupled = np.asarray(between_feet(model, robot))
        self.feet = [model.body(foot).id for foot in robot.feet]
        self.soles = [sole_point(model, foot) for foot in robot.feet]

    def base_pose(self, angles: np.ndarray, foot: int = 0) -> np.ndarray:
        """Return the pose of the free body with a sole flat on the origin, (7,) [m, quaternion].

        The foot is 0 for the stance sole and 1 for the swing sole.
        """
        sole, _ = self._feet(angles, np.array([0.0, 0, 0, 1, 0, 0, 0]))[foot]
        inverse, position = np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(inverse, self.data.xquat[self.feet[foot]])
        mujoco.mju_rotVecQuat(position, -sole, inverse)
        return np.concatenate([position, inverse])

    def swing_pose(self, angles: np.ndarray) -> np.ndarray:
        """Return the planar pose of the swing foot in the base frame, (3,) [m, m, rad]."""
        (stance, first), (swing, second) = self._feet(angles, np.array([0.0, 0, 0, 1, 0, 0, 0]))
        (x, y, _), turned = first.T @ (swing - stance), first.T @ second
        return np.array([x, y, np.arctan2(turned[1, 0], turned[0, 0])])

    def path(self, start: np.ndarray, end: np.ndarray, steps: int) -> np.ndarray:
        """Compute the joint angles from `start` (excluded) to `end`, (steps, n) [rad].

        The torso moves on a straight line at minimum jerk while the feet stay in place, so that the load
        moves monotonically from foot to foot, which a line in joint space does not ensure. Joints that are
        not between the feet move on a line too; Newton's method gives the angles of the others.
        """
        s = _minimum_jerk(steps)
        first, last = self.base_pose(start), self.base_pose(end)
        turn = np.zeros(3)
        mujoco.mju_subQuat(turn, last[3:], first[3:])
        ends = [self._feet(start, first), self._feet(end, last)]
        path, corrections = np.empty((steps, len(start))), np.zeros((3, len(start)))
        for k, part in enumerate(s):
            pose = first.copy()
            pose[:3] += part * (last[:3] - first[:3])
            mujoco.mju_quatIntegrate(pose[3:], turn, part)
            # The feet of both ends differ by the rounding of the plan only; interpolate between them.
            wanted = [
                (p + part * (p1 - p), r + part * (r1 - r)) for (p, r), (p1, r1) in zip(*ends, strict=True)
            ]
            straight = start + part * (end - start)
            # A parabola through the last three steps predicts this one.
            guess = straight + np.array([3.0, -3.0, 1.0]) @ corrections
            path[k] = self._close(guess, pose, wanted)
            corrections = np.vstack([path[k] - straight, corrections[:2]])
        path[-1] = end
        return path

    def _close(self, angles: np.ndarray, pose: np.ndarray, wanted: list) -> np.ndarray:
        """Return angles near `angles` that put the soles at their poses, with the torso at `pose`."""
        for _ in range(NEWTON_STEPS):
            actual = self._feet(angles, pose)
            error = np.concatenate([_difference(a, w) for a, w in zip(actual, wanted, strict=True)])
            if np.abs(error).max() < TOLERANCE:
                break
            jacobian = np.zeros((12, self.model.nv))
            for k, (foot, (sole, _)) in enumerate(zip(self.feet, actual, strict=True)):
                place, turn = jacobian[6 * k : 6 * k + 3], jacobian[6 * k + 3 : 6 * k + 6]
                mujoco.mj_jac(self.model, self.data, place, turn, sole, foot)
            change = np.linalg.lstsq(jacobian[:, self.dofs[self.coupled]], error, rcond=1e-6)[0]
            angles = angles.copy()
            angles[self.coupled] -= change
        return angles

    def _feet(self, angles: np.ndarray, pose: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the point below the ankle (3,) and the rotation (3, 3) of both soles."""
        data = self.data
        data.qpos[:7], data.qpos[self.qpos] = pose, angles
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        rotations = [data.xmat[foot].reshape(3, 3).copy() for foot in self.feet]
        return [
            (data.xpos[foot] + rotation @ sole, rotation)
            for foot, rotation, sole in zip(self.feet, rotations, self.soles, strict=True)
        ]


def smooth_path(
    start: np.ndarray,
    path_between: Callable[[np.ndarray, np.ndarray, int], np.ndarray],
    end: np.ndarray,
    duration: float,
) -> scipy.interpolate.CubicSpline:
    """Return the joint angles over time from `start` to `end`, as the laboratory moves in a duration [s].

    The path between them is `ClosedChain.path` or `straight_path`.
    """
    knots = np.vstack([start, path_between(start, end, PATH_KNOTS)])
    time = np.linspace(0, duration, PATH_KNOTS + 1)
    return scipy.interpolate.CubicSpline(time, knots, bc_type="clamped")


def straight_path(start: np.ndarray, end: np.ndarray, steps: int) -> np.ndarray:
    """Compute joint angles from `start` (excluded) to `end` on a line at minimum jerk, (steps, n) [rad]."""
    return start + _minimum_jerk(steps)[:, None] * (end - start)


def _minimum_jerk(steps: int) -> np.ndarray:
    s = np.arange(1, steps + 1) / steps
    return s**3 * (10 - 15 * s + 6 * s**2)


def tipped(pose: np.ndarray, planned: np.ndarray, tilt_limit: float) -> bool:
    """Return whether the free body leans more than a limit [rad] beyond its plan or is too high or too low.

    Both poses are (7,) [m, quaternion]; the height may differ by a fifth.
    """
    lean = np.zeros(3)
    mujoco.mju_subQuat(lean, pose[3:], planned[3:])
    return bool(np.linalg.norm(lean[:2]) > tilt_limit or abs(pose[2] - planned[2]) > 0.2 * planned[2])


def _difference(actual: tuple[np.ndarray, np.ndarray], wanted: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the pose error of a sole: translation and small rotation, (6,) [m, rad]."""
    r = actual[1] @ wanted[1].T
    turned = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    return np.concatenate([actual[0] - wanted[0], turned])
