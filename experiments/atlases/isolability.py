"""Which effects look alike: angles between their columns, whitened and projected."""

from __future__ import annotations

import numpy as np
import scipy

# From there on the right one comes first in 95 % (docs/how-to/atlas.md, seeds 0 to 99).
ISOLABLE = np.radians(15.0)


def angles(blocks: list[list[np.ndarray]]) -> np.ndarray:
    """Smallest angle between any direction of one candidate and any of another, (n, n) [rad].

    Args:
        blocks: columns of every candidate at every point of its grid, (r, s).
    """
    owner = np.repeat(np.arange(len(blocks)), [len(points) for points in blocks])
    width = max(column.shape[1] for points in blocks for column in points)
    bases = np.zeros((len(owner), blocks[0][0].shape[0], width))
    for base, column in zip(bases, (c for points in blocks for c in points), strict=True):
        left, size, _ = np.linalg.svd(column, full_matrices=False)
        rank = int((size > 1e-6 * size.max(initial=0.0)).sum())
        base[:, :rank] = left[:, :rank]
    out = np.full((len(blocks), len(blocks)), np.pi / 2)
    for k in range(len(blocks)):
        mine = bases[owner == k]
        inner = np.einsum("arv,brw->abvw", mine, bases, optimize=True)
        cosine = np.linalg.norm(inner, ord=2, axis=(2, 3)).max(axis=0)
        for other in range(len(blocks)):
            out[k, other] = np.arccos(min(1.0, float(cosine[owner == other].max())))
    np.fill_diagonal(out, 0.0)
    return np.minimum(out, out.T)


def groups(angle: np.ndarray) -> list[list[int]]:
    """Candidates any two of which are closer than `ISOLABLE`, by complete linkage; the largest first."""
    if len(angle) < 2:
        return []
    near = scipy.spatial.distance.squareform(angle, checks=False)
    tree = scipy.cluster.hierarchy.linkage(near, "complete")
    label = scipy.cluster.hierarchy.fcluster(tree, ISOLABLE, "distance")
    alike = [np.flatnonzero(label == number).tolist() for number in np.unique(label)]
    return sorted((group for group in alike if len(group) > 1), key=lambda group: (-len(group), group))
