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

RANK = 1e-6  # part of the information about the best known direction, below which one is not known
SEEN = 1e-2  # information about one tolerance, below which it would have to be tens of them to be seen


@dataclass(frozen=True)
class Usual:
    """Changes by one tolerance of each of k ordinary imperfections.

    Attributes:
        names: of the imperfections, (k,).
        center: of the centre of pressure less the centre of mass, (m, 2, k) [m].
        total: of the sum of the cells, (m, k) [N].
        closure: of the swing sole's height, roll and pitch, (m, 3, k) [m, rad, rad].
        unseen: of the same by j forces that no cell shows, through joints that yield, (m, 3, j); they differ
            from posture to posture.
    """

    names: tuple[str, ...]
    center: np.ndarray
    total: np.ndarray
    closure: np.ndarray
    unseen: np.ndarray


UsualChanges = Callable[[], Usual]


def exact(rows: int) -> Usual:
    """Return the changes in a laboratory without imperfections."""
    closure = np.zeros((rows, 3, 0))
    return Usual((), np.zeros((rows, 2, 0)), np.zeros((rows, 0)), closure, closure)


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
    known = size > RANK * size.max(initial=0.0)
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
    parts = [float(chi2_sf(max(left, 0.0), dof)) if dof > 0 else 1.0, bonferroni(chi2_sf(rows, rank))]
    singly = beyond_singly(score, information)
    return bonferroni(np.array([*parts, singly.min()] if singly.size else parts))


def beyond_singly(score: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Return the probability of as large a change in any direction, for each of several directions, (k,).

    V is the null. Directions that the readings do not see are not counted; theirs is 1.

    Args:
        score: K' V^-1 e, (k,). information: the diagonal of K' V^-1 K, (k,).
    """
    seen = information > SEEN
    out = np.ones(len(score))
    out[seen] = np.minimum(2 * normal_sf(np.abs(score[seen]) / np.sqrt(information[seen])) * seen.sum(), 1.0)
    return out
