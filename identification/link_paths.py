"""Distances between links on the way from one posture to the next, as the laboratory moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tulip_testbed.identification.kinematics import frame_positions, link_rotations
from tulip_testbed.identification.link_clearances import Clearances, LinkPairs, clearances_at
from tulip_testbed.sim.path import smooth_path

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
    """Return the links that lack most of what they need, as text, or None if all keep it.

    Args:
        needed: distance that each pair must keep, (p,) [m].
    """
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
