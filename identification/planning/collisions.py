"""Constraints on the distances between links, and between links and the ground, with derivatives."""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.link_clearances import clearances
from tulip_testbed.identification.planning.closed_chain import Chain, cross
from tulip_testbed.identification.planning.problem import Problem

NEAREST = 12  # pairs of links of a posture that are constrained
BEYOND = 0.02  # m: links that are farther from each other than needed by this count as being there


def nearest_count(problem: Problem) -> int:
    """Return the number of pairs of links that are constrained in each posture."""
    return min(NEAREST, len(problem.pairs.names))


def link_room(problem: Problem, chain: Chain, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the distances of the nearest pairs of links beyond what they must keep.

    Args:
        problem: the robot and its constraints.
        chain: the postures.
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
