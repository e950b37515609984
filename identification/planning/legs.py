"""Constraints on the legs: static torques and clearance between the legs, with derivatives."""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.planning.closed_chain import Chain, cross, point_jacobian
from tulip_testbed.identification.planning.problem import Problem
from tulip_testbed.identification.segments import nearest_on_segments, on_segments


def holding_torques(
    problem: Problem, chain: Chain, wrench: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the drive torques that hold the robot under a given wrench of the floor on the swing foot.

    Seen from the stance foot, joint j carries the weights beyond it and the wrench w (force and moment about
    the base frame's origin): tau = tau_0 + A w, A_j = -(p_j x a_j, a_j). The chain is closed, so that statics
    does not determine w; the commanded torques do. Dry friction is neglected.

    Args:
        problem: the robot.
        chain: the postures.
        wrench: w, (m, 6) [N, N m].

    Returns:
        tau, (m, n) [N m]; its derivative by the joint angles at constant w, (m, n, n); A, (m, n, 6).
    """
    axes, pivots, gravity = chain.axes, chain.pivots, problem.gravity
    load = -gravity * (chain.moment - chain.beyond[:, None] * pivots)
    own = axes[..., 1] * load[..., 0] - axes[..., 0] * load[..., 1]
    bears = problem.moved[:, problem.swing].astype(float)[:, None]  # joints that carry the swing foot
    lines = -np.concatenate([cross(pivots, axes), axes], axis=2) * bears

    # Turning joint i moves axis and pivot of every joint j beyond it, and the masses beyond both.
    up = problem.upstream[..., None]  # [i, j]
    axis_i, pivot_i = axes[:, :, None], pivots[:, :, None]
    turned_axis = cross(axis_i, axes[:, None]) * up
    moved_pivot = cross(axis_i, pivots[:, None] - pivot_i) * up
    both = problem.moved[:, None] & problem.moved[None]
    places = chain.positions + (chain.rotations @ problem.center[..., None])[..., 0]
    count = len(problem.moved)
    mass = both @ problem.mass
    moment = ((both * problem.mass).reshape(count * count, -1) @ places).reshape(-1, count, count, 3)
    moved_load = -gravity * (
        cross(axis_i, moment - mass[..., None] * pivot_i) - chain.beyond[:, None] * moved_pivot
    )
    own_slope = (
        turned_axis[..., 1] * load[:, None, :, 0]
        - turned_axis[..., 0] * load[:, None, :, 1]
        + axes[:, None, :, 1] * moved_load[..., 0]
        - axes[:, None, :, 0] * moved_load[..., 1]
    ).mT
    arm_slope = cross(moved_pivot, axes[:, None]) + cross(pivots[:, None], turned_axis)
    line_slope = -np.concatenate([arm_slope, turned_axis], axis=3) * bears  # (m, i, j, 6)

    torque = own + (lines @ wrench[..., None])[..., 0]
    return torque, own_slope + (line_slope @ wrench[:, None, :, None])[..., 0].mT, lines


def limb_distances(problem: Problem, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Compute the distances between the capsules of the two legs, negative if they overlap.

    Returns:
        Distances, (m, pairs) [m], and their derivatives by the joint angles, (m, pairs, n). The nearest
        points are held fixed on their limbs, which is exact to first order.
    """
    ends = {frame for leg in problem.limbs for limb in leg for frame in limb[:2]}
    slopes = {frame: point_jacobian(problem, chain, frame) for frame in ends}
    distances, gradients = [], []
    for a, b, radius in problem.limbs[0]:
        for c, d, other in problem.limbs[1]:
            first, second = chain.positions[:, [a, b]], chain.positions[:, [c, d]]
            s, t = nearest_on_segments(first, second)
            away = on_segments(second, t) - on_segments(first, s)
            length = np.linalg.norm(away, axis=1)
            normal = away / np.maximum(length, 1e-9)[:, None]
            slope = (1 - t)[:, None, None] * slopes[c] + t[:, None, None] * slopes[d]
            slope = slope - (1 - s)[:, None, None] * slopes[a] - s[:, None, None] * slopes[b]
            distances.append(length - radius - other)
            gradients.append((normal[:, None] @ slope)[:, 0])
    if not distances:
        count = len(chain.angles)
        return np.zeros((count, 0)), np.zeros((count, 0, chain.angles.shape[1]))
    return np.stack(distances, axis=1), np.stack(gradients, axis=1)


def leg_stretch(problem: Problem, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Return the shortening of hip to ankle against a straight knee, (m, legs) [m], and its derivative."""
    room, slopes = [], []
    for hip, ankle, length in problem.legs:
        line = chain.positions[:, ankle] - chain.positions[:, hip]
        distance = np.linalg.norm(line, axis=1)
        slope = point_jacobian(problem, chain, ankle) - point_jacobian(problem, chain, hip)
        room.append(length - distance)
        slopes.append(-((line / distance[:, None])[:, None] @ slope)[:, 0])
    if not room:
        return np.zeros((len(chain.angles), 0)), np.zeros((len(chain.angles), 0, chain.angles.shape[1]))
    return np.stack(room, axis=1), np.stack(slopes, axis=1)
