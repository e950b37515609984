"""Paths between postures: the distances between links on the way, and orders of postures that keep them."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tulip_testbed.identification.kinematics import frame_positions, link_rotations
from tulip_testbed.identification.link_clearances import Clearances, LinkPairs, clearances_at
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.path import ClosedChain, smooth_path
from tulip_testbed.sim.robot import Robot

PathBetween = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
SHARE = 0.5  # of the distance that links keep in postures is enough on the way
LEAST_STEP = 1e-3  # m, between samples of a path
COARSE = 32  # samples before the steps are known


def path_clearances(
    pairs: LinkPairs, path_between: PathBetween, start: np.ndarray, end: np.ndarray, within: float
) -> Clearances:
    """Compute the distances between links on the laboratory's path between two postures.

    Only the parts of the path where links come near are looked at. There none moves by more than a quarter of
    the distance to keep between two samples, so links that keep `SHARE` of it at the samples do not touch
    between them.

    Args:
        path_between: `ClosedChain.path` on both feet, `straight_path` on one.
        start, end: joint angles of both postures, (n,) [rad].
        within: largest distance to compute [m].

    Returns:
        The distances at some times of the path, or at none if no links come near.
    """
    path = smooth_path(start, path_between, end, 1.0)
    time = np.linspace(0.0, 1.0, COARSE + 1)
    ends = _ends(pairs, path(time))
    moved = np.linalg.norm(np.diff(ends, axis=0), axis=-1).max(axis=(1, 2))
    coarse = clearances_at(pairs, path(time), within + moved.max()).distance.min(axis=1, initial=np.inf)
    near = np.minimum(coarse[1:], coarse[:-1]) < within + moved
    step = max(pairs.needed.max(initial=0.0) / 4, LEAST_STEP)
    counts = np.ceil(moved / step).astype(int)
    fine = [np.linspace(time[k], time[k + 1], max(int(counts[k]), 1) + 1) for k in np.flatnonzero(near)]
    return clearances_at(pairs, path(np.concatenate([np.zeros(0), *fine])), within)


def blocked(pairs: LinkPairs, path_between: PathBetween, start: np.ndarray, end: np.ndarray) -> str | None:
    """Return which links come too near to each other on the path between two postures, or None."""
    needed = SHARE * pairs.needed
    found = path_clearances(pairs, path_between, start, end, needed.max(initial=0.0))
    return too_near(pairs, found, needed)


def too_near(pairs: LinkPairs, found: Clearances, needed: np.ndarray) -> str | None:
    """Return the links that lack most of the distance that they need, (p,) [m], or None if all keep it."""
    lack = (needed - found.distance).max(axis=0, initial=0.0)
    if not (lack > 0).any():
        return None
    return " and ".join(pairs.names[int(lack.argmax())])


def _ends(pairs: LinkPairs, joint_angles: np.ndarray) -> np.ndarray:
    """Return the ends of the capsules around all shapes, (m, g, 2, 3) [m]."""
    shapes = pairs.shapes
    rotations = link_rotations(shapes.tree, shapes.base, joint_angles)
    positions = frame_positions(shapes.tree, shapes.base, rotations, shapes.origin)
    return positions[:, shapes.frame, None] + shapes.ends @ rotations[:, shapes.frame].mT


def with_free_paths(robot: Robot, pairs: LinkPairs, plan: PosturePlan) -> PosturePlan:
    """Return a plan on both feet whose links keep apart on the paths between its postures.

    Placements keep the order of their postures if they can. If no order will do, the robot is lifted and put
    down instead: the rest becomes placements with the same foot pose at the end of the plan.
    """
    chain = ClosedChain(robot.model, robot)
    kept, added = [], []
    for number in dict.fromkeys(plan.placement.tolist()):
        rows = np.flatnonzero(plan.placement == number)
        first, *rest = _groups(pairs, chain, plan.joint_angles[rows])
        kept.append((number, rows[first]))
        added += [rows[group] for group in rest]
    last = int(plan.placement.max())
    parts = [*kept, *enumerate(added, last + 1)]
    moved = plan.take(np.concatenate([rows for _, rows in parts]))
    placement = np.repeat([number for number, _ in parts], [len(rows) for _, rows in parts])
    return replace(moved, posture=plan.posture, placement=placement)


def _groups(pairs: LinkPairs, chain: ClosedChain, angles: np.ndarray) -> list[np.ndarray]:
    """Split postures (k, n) into as few sequences with free paths as a greedy search finds."""
    count = len(angles)

    def is_free(a: int, b: int) -> bool:
        return blocked(pairs, chain.path, angles[a], angles[b]) is None

    if all(is_free(k, k + 1) for k in range(count - 1)):
        return [np.arange(count)]
    free = np.zeros((count, count), bool)
    for a, b in itertools.combinations(range(count), 2):
        free[a, b] = free[b, a] = is_free(a, b)
    return [np.array(group) for group in min((_sequences(free, k) for k in range(count)), key=len)]


def _sequences(free: np.ndarray, first: int) -> list[list[int]]:
    """Order postures along free paths, (m, m) bool, beginning with one; a new group where there is none."""
    left, groups = [k for k in range(len(free)) if k != first], [[first]]
    while left:
        ahead = [k for k in left if free[groups[-1][-1], k]]
        if not ahead:
            groups.append([])
        groups[-1].append((ahead or left)[0])
        left.remove(groups[-1][-1])
    return groups
