"""Joint angles from centre of mass, torso orientation and swing foot pose, with derivatives, in batches.

In double support twelve equations determine twelve joints: the swing foot's pose (6), the torso's orientation
(3) and the centre of mass (3). For F(q, u) = 0 the implicit function theorem gives dq/du = -(dF/dq)^-1 dF/du.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tulip_testbed.identification.nominal import PostureGeometry
from tulip_testbed.identification.planning.problem import PlanningProblem

TOLERANCE = 1e-11  # of every equation [m, rad]
ITERATIONS = 25
LONGEST_STEP = 0.3  # rad
DESIGN = 9  # variables of a posture: CoM (3), torso roll, pitch, yaw, swing foot x, y, yaw


@dataclass(frozen=True)
class Chain(PostureGeometry):
    """Geometry of m postures on the stance foot with the masses that joints carry; n joints, f frames."""

    nominal: PlanningProblem

    @property
    def positions(self) -> np.ndarray:
        """Return the origins of all frames in the base frame, (m, f, 3) [m]."""
        return self.frames[1]

    @cached_property
    def places(self) -> np.ndarray:
        """Compute the centre of mass of every frame, (m, f, 3) [m]."""
        return self.positions + (self.rotations @ self.nominal.centers[..., None])[..., 0]

    @cached_property
    def com(self) -> np.ndarray:
        """Compute the centre of mass, (m, 3) [m]."""
        masses = self.nominal.masses
        return (masses[:, None] * self.places).sum(axis=1) / masses.sum()

    @cached_property
    def moment(self) -> np.ndarray:
        """Compute the first moment about its pivot of the mass that each joint carries, (m, n, 3) [kg m]."""
        masses, moved = self.nominal.masses, self.nominal.moved
        return moved @ (masses[:, None] * self.places) - (moved @ masses)[:, None] * self.pivots


def chain_at(problem: PlanningProblem, angles: np.ndarray) -> Chain:
    """Return postures with joint angles (m, n) [rad]; what is computed of them is computed once."""
    return Chain(**vars(problem.geometry(angles)))


def com_jacobian(problem: PlanningProblem, chain: Chain) -> np.ndarray:
    """Differentiate the centre of mass by the joint angles, (m, 3, n) [m/rad]."""
    return cross(chain.axes, chain.moment / problem.masses.sum()).mT


def point_jacobian(problem: PlanningProblem, chain: Chain, frame: int) -> np.ndarray:
    """Differentiate a frame's origin by the joint angles, (m, 3, n) [m/rad]."""
    arm = (chain.positions[:, frame, None] - chain.pivots) * problem.moved[:, frame, None]
    return cross(chain.axes, arm).mT


def open_chain_torques(problem: PlanningProblem, chain: Chain) -> np.ndarray:
    """Compute the drive torques that hold the robot on its stance foot, (m, n) [N m].

    A drive carries the moment of the weight beyond it about its axis: tau = -a . (r x m g).
    """
    load = -problem.gravity * chain.moment
    return chain.axes[..., 1] * load[..., 0] - chain.axes[..., 0] * load[..., 1]


def holding_torques(
    problem: PlanningProblem, chain: Chain, wrench: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the drive torques that hold the robot under a given wrench of the floor on the swing foot.

    Seen from the stance foot, joint j carries the weights beyond it and the wrench w (force and moment about
    the base frame's origin, (m, 6) [N, N m]): tau = tau_0 + A w, A_j = -(p_j x a_j, a_j). The chain is
    closed, so that statics does not determine w; the commanded torques do. Dry friction is neglected.

    Returns:
        tau, (m, n) [N m]; its derivative by the joint angles at constant w, (m, n, n); A, (m, n, 6).
    """
    axes, pivots, gravity = chain.axes, chain.pivots, problem.gravity
    load = -problem.gravity * chain.moment
    bears = problem.moved[:, problem.swing_frame].astype(float)[:, None]  # joints that carry the swing foot
    lines = -np.concatenate([cross(pivots, axes), axes], axis=2) * bears

    # Turning joint i moves axis and pivot of every joint j beyond it, and the masses beyond both.
    up = problem.upstream[..., None]  # [i, j]
    axis_i, pivot_i = axes[:, :, None], pivots[:, :, None]
    turned_axis = cross(axis_i, axes[:, None]) * up
    moved_pivot = cross(axis_i, pivots[:, None] - pivot_i) * up
    both = problem.moved[:, None] & problem.moved[None]
    count = len(problem.moved)
    mass = both @ problem.masses
    moment = ((both * problem.masses).reshape(count * count, -1) @ chain.places).reshape(-1, count, count, 3)
    moved_load = -gravity * (
        cross(axis_i, moment - mass[..., None] * pivot_i)
        - (problem.moved @ problem.masses)[:, None] * moved_pivot
    )
    own_slope = (
        turned_axis[..., 1] * load[:, None, :, 0]
        - turned_axis[..., 0] * load[:, None, :, 1]
        + axes[:, None, :, 1] * moved_load[..., 0]
        - axes[:, None, :, 0] * moved_load[..., 1]
    ).mT
    arm_slope = cross(moved_pivot, axes[:, None]) + cross(pivots[:, None], turned_axis)
    line_slope = -np.concatenate([arm_slope, turned_axis], axis=3) * bears  # (m, i, j, 6)

    torque = open_chain_torques(problem, chain) + (lines @ wrench[..., None])[..., 0]
    return torque, own_slope + (line_slope @ wrench[:, None, :, None])[..., 0].mT, lines


def torso_turn(rpy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation of roll, pitch, yaw (m, 3), (m, 3, 3), and the angular velocity of each, (m, 3, 3).

    R = R_z(yaw) R_y(pitch) R_x(roll); the angular velocities are columns in the base frame.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy).T, np.sin(rpy).T
    zero, one = np.zeros_like(cr), np.ones_like(cr)
    turn = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    ).transpose(2, 0, 1)
    rates = np.array([[cy * cp, -sy, zero], [sy * cp, cy, zero], [-sp, zero, one]]).transpose(2, 0, 1)
    return turn, rates


def solve_chain(
    problem: PlanningProblem, com: np.ndarray, rpy: np.ndarray, swing: np.ndarray, guess: np.ndarray
) -> tuple[Chain, np.ndarray, np.ndarray]:
    """Solve for the joint angles of all postures by Newton's method from a guess on the intended branch.

    Args:
        com: centre of mass, (m, 3) [m].
        rpy: roll, pitch, yaw of the torso, (m, 3) [rad].
        swing: planar pose of the swing foot, (m, 3) [m, m, rad].
        guess: joint angles, (m, n) [rad]; joints that are not between the feet keep them.

    Returns:
        The postures; the largest residual of the equations, (m,) [m, rad]; dq/du by the implicit function
        theorem, (m, n, 9).
    """
    torso, rates = torso_turn(rpy)
    angles = guess.copy()
    cy, sy = np.cos(swing[:, 2]), np.sin(swing[:, 2])
    foot = np.zeros((len(swing), 3, 3))
    foot[:, 0, 0], foot[:, 0, 1], foot[:, 1, 0], foot[:, 1, 1], foot[:, 2, 2] = cy, -sy, sy, cy, 1.0
    place = np.column_stack([swing[:, :2], np.zeros(len(swing))]) - foot @ problem.points[1]
    for count in range(ITERATIONS + 1):
        chain = chain_at(problem, angles)
        left = np.concatenate(
            [
                place - chain.positions[:, problem.swing_frame],
                _difference(chain.rotations[:, problem.swing_frame], foot),
                _difference(chain.rotations[:, problem.torso], torso),
                com - chain.com,
            ],
            axis=1,
        )
        slope = _equations(problem, chain)
        worst = np.abs(left).max(axis=1)
        if worst.max() < TOLERANCE or count == ITERATIONS:
            break
        step = _solve(slope, left[..., None])[..., 0]
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        angles = angles.copy()
        angles[:, problem.between] += step
    wanted = np.zeros((len(swing), len(slope[0]), DESIGN))  # -dF/du, the change of the targets
    wanted[:, 0:2, 6:8] = np.eye(2)
    wanted[:, 0:3, 8] = cross(np.array([0.0, 0.0, 1.0]), -(foot @ problem.points[1]))
    wanted[:, 5, 8] = 1.0
    wanted[:, 6:9, 3:6] = rates
    wanted[:, 9:12, 0:3] = np.eye(3)
    derivative = np.zeros((len(swing), angles.shape[1], DESIGN))
    derivative[:, problem.between] = _solve(slope, wanted)
    return chain, worst, derivative


def _equations(problem: PlanningProblem, chain: Chain) -> np.ndarray:
    """Return dF/dq for the joints between the feet, (m, 12, 12)."""
    moved = problem.moved
    turning = chain.axes.mT
    rows = [
        point_jacobian(problem, chain, problem.swing_frame),
        turning * moved[:, problem.swing_frame],
        turning * moved[:, problem.torso],
        com_jacobian(problem, chain),
    ]
    return np.concatenate(rows, axis=1)[..., problem.between]


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the cross product along the last axis, in a third of `numpy.cross`'s time."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    x, y, z = second[..., 0], second[..., 1], second[..., 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def _difference(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the rotation from one orientation to another, to first order, (m, 3) [rad]."""
    return 0.5 * cross(found.mT, wanted.mT).sum(axis=1)


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve the twelve equations, with damping if legs are exactly straight."""
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        damped = matrix.mT @ matrix + 1e-9 * np.eye(matrix.shape[2])
        return np.linalg.solve(damped, matrix.mT @ right)
