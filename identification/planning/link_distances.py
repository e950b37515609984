"""Distances between links, legs and the ground, and how far the legs are from straight, with derivatives."""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.link_clearances import clearances
from tulip_testbed.identification.planning.closed_chain import Chain, cross, point_jacobian
from tulip_testbed.identification.planning.problem import PlanningProblem
from tulip_testbed.identification.segments import nearest_on_segments, on_segments

NEAREST = 12  # pairs of links of a posture that are constrained
BEYOND = 0.02  # m: links that are farther from each other than needed by this count as being there


def nearest_count(problem: PlanningProblem) -> int:
    """Return the number of pairs of links that are constrained in each posture."""
    return min(NEAREST, len(problem.pairs.names))


def link_room(problem: PlanningProblem, chain: Chain, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the distances of the nearest pairs of links beyond what they must keep.

    Args:
        wanted: postures to look at, (m,) bool; in the others all links count as far from each other.

    Returns:
        Distances in the order of the pairs, (m, s) [m], and their derivatives by the joint angles, (m, s, n).
        The nearest points are held fixed on their links, which is exact to first order.
    """
    pairs, kept = problem.pairs, nearest_count(problem)
    within, rows = problem.margins.link_clearance + BEYOND, np.flatnonzero(wanted)
    values = np.full((len(wanted), kept), BEYOND)
    slopes = np.zeros((len(wanted), kept, chain.angles.shape[1]))
    if not kept:
        return values, slopes
    found = clearances(pairs, chain.rotations[rows], chain.positions[rows], within)
    room = found.distance - pairs.needed
    chosen = np.sort(np.argpartition(room, kept - 1, axis=1)[:, :kept], axis=1)
    values[rows] = np.take_along_axis(room, chosen, axis=1)
    place = np.full(room.shape, -1)
    np.put_along_axis(place, chosen, np.arange(kept), axis=1)
    slot = place[found.posture, found.pair]
    used = slot >= 0
    posture, frames = rows[found.posture[used]], pairs.frames[found.pair[used]]
    axes, pivots = chain.axes[posture], chain.pivots[posture]
    for sign, k in ((-1, 0), (1, 1)):
        arm = found.points[used, k, None] - pivots
        speed = (cross(axes, arm) * found.normal[used, None]).sum(axis=2)
        slopes[posture, slot[used]] += sign * speed * problem.moved[:, frames[:, k]].T
    return values, slopes


def limb_distances(problem: PlanningProblem, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
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


def leg_stretch(problem: PlanningProblem, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
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
