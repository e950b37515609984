"""What ordinary imperfections do to readings, and whether readings lie beyond them and the noise.

The whitened deviations are e = K phi + noise of s.d. 1, with phi ~ N(0, 1): K is the change by one tolerance
of each imperfection. Three tests have V = I + K K' in common: what no imperfection of any size changes, the
single rows, and single directions, those of the imperfections among them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.distributions import chi2_sf, normal_sf
from tulip_testbed.identification.preflight.finding import bonferroni

SEEN = 1e-6  # part of the information about the best known direction, below which one is not seen


@dataclass(frozen=True)
class Usual:
    """Changes by one tolerance of each of k ordinary imperfections.

    Attributes:
        total: of the sum of the cells, (m, k) [N].
        closure: of the swing sole's height, roll and pitch, (m, 3, k) [m, rad, rad].
        unseen: of the same by j forces that no cell shows, through joints that yield, (m, 3, j); they differ
            from posture to posture.
    """

    total: np.ndarray
    closure: np.ndarray
    unseen: np.ndarray


UsualChanges = Callable[[], Usual]


def exact(rows: int) -> Usual:
    """Return the changes in a laboratory without imperfections."""
    return Usual(np.zeros((rows, 0)), np.zeros((rows, 3, 0)), np.zeros((rows, 3, 0)))


def beyond(
    white: np.ndarray, rank: np.ndarray, changes: np.ndarray, directions: np.ndarray | None = None
) -> float:
    """Return the probability that noise and ordinary imperfections deviate as much.

    Args:
        white: deviations over their noise, (m, r). rank: of each row's noise, (m,), 1 to r.
        changes: whitened as they are, of one tolerance of each imperfection, (m, r, k).
        directions: other changes that are tested, (m, r, d).
    """
    flat, k = changes.reshape(white.size, -1), changes.shape[2]
    gram, pull = flat.T @ flat, flat.T @ white.ravel()
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    size, vectors = np.linalg.eigh(gram / scale / scale[:, None])
    known = size > SEEN * size.max(initial=0.0)
    along = vectors[:, known].T @ (pull / scale)
    left, dof = float((white**2).sum() - (along**2 / size[known]).sum()), int(rank.sum() - known.sum())
    # K'V^-1 = (I + K'K)^-1 K'.
    inverse = np.linalg.inv(np.eye(k) + gram)
    weighted = white - changes @ (inverse @ pull)
    precision = np.eye(white.shape[1]) - changes @ inverse @ changes.mT
    rows = (weighted * np.linalg.solve(precision, weighted[..., None])[..., 0]).sum(axis=1)
    tested = changes if directions is None else np.concatenate([changes, directions], axis=2)
    tested = tested.reshape(white.size, -1)
    score, across = tested.T @ weighted.ravel(), tested.T @ flat
    information = (tested**2).sum(axis=0) - (across @ inverse * across).sum(axis=1)
    seen = information > SEEN
    singly = 2 * normal_sf(np.abs(score[seen]) / np.sqrt(information[seen]))
    parts = [float(chi2_sf(max(left, 0.0), dof)) if dof > 0 else 1.0, bonferroni(chi2_sf(rows, rank))]
    return bonferroni(np.array([*parts, bonferroni(singly)] if singly.size else parts))
