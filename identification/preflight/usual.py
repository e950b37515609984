"""Changes of readings by ordinary imperfections, and whether readings lie beyond them and the noise.

The whitened deviations are e = K phi + noise of s.d. 1, with phi ~ N(0, 1): K is the change by one tolerance
of each imperfection. Three tests have V = I + K K' in common: what no imperfection of any size changes, the
single rows, and single directions, those of the imperfections among them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.distributions import chi2_sf, normal_sf
from tulip_testbed.identification.preflight.finding import bonferroni, result_of
from tulip_testbed.measurements import Measurements

RANK = 1e-6  # part of the information about the best known direction, below which one is not known
UNUSUAL = 3.0  # tolerances, from which an imperfection is worth a warning
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


UsualChanges = Callable[[Measurements], Usual]


def exact(m: Measurements) -> Usual:
    """Return the changes in a laboratory without imperfections."""
    closure = np.zeros((len(m), 3, 0))
    return Usual((), np.zeros((len(m), 2, 0)), np.zeros((len(m), 0)), closure, closure)


@dataclass(frozen=True)
class Beyond:
    """How far readings lie beyond noise and ordinary imperfections.

    Attributes:
        p_value: probability that these deviate as much.
        name: of the imperfection that deviates most, "" if none is seen. sizes: by how many of its s.d.
    """

    p_value: float
    name: str
    sizes: float

    @property
    def result(self) -> str:
        """Return "warn" for an imperfection larger than usual, though it may be one by chance."""
        found = result_of(self.p_value)
        return "warn" if found == "pass" and self.sizes > UNUSUAL else found

    @property
    def words(self) -> str:
        """Name the imperfection if it is larger than usual, with a separator before it."""
        if self.sizes <= UNUSUAL:
            return ""
        return f"; most unusual: {self.name}, {self.sizes:.1f} s.d. of what is usual"


def beyond(
    white: np.ndarray,
    rank: np.ndarray,
    changes: np.ndarray,
    names: Sequence[str],
    directions: np.ndarray | None = None,
) -> Beyond:
    """Test deviations against noise and ordinary imperfections.

    Args:
        white: deviations over their noise, (m, r). rank: of each row's noise, (m,), 1 to r.
        changes: whitened as they are, of one tolerance of each imperfection, (m, r, k).
        names: of the imperfections, (k,).
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
    parts = [float(chi2_sf(max(left, 0.0), dof)) if dof > 0 else 1.0, bonferroni(chi2_sf(rows, rank))]
    if directions is not None:
        flat_too = directions.reshape(white.size, -1)
        flat_too = flat_too / np.maximum(np.linalg.norm(flat_too, axis=0), 1e-300)
        common = flat_too.T @ flat
        information = 1 - ((common @ inverse) * common).sum(axis=1)
        told = information > RANK  # imperfections leave nothing of the others
        score = np.abs(flat_too.T @ weighted.ravel()) / np.sqrt(np.maximum(information, RANK))
        parts.append(bonferroni(2 * normal_sf(np.where(told, score, 0.0))))
    return singly(flat.T @ weighted.ravel(), np.diag(gram - gram @ inverse @ gram), names, parts)


def singly(score: np.ndarray, information: np.ndarray, names: Sequence[str], parts: list[float]) -> Beyond:
    """Test the change that each imperfection makes, together with other tests; V is the null.

    The score is K' V^-1 e, (k,), the information the diagonal of K' V^-1 K, (k,); the parts are p-values of
    the other tests.
    """
    seen = np.flatnonzero(information > SEEN)
    if not seen.size:
        return Beyond(bonferroni(parts), "", 0.0)
    sizes = np.abs(score[seen]) / np.sqrt(information[seen])
    largest = int(sizes.argmax())
    p_value = bonferroni([*parts, bonferroni(2 * normal_sf(sizes))])
    return Beyond(p_value, names[seen[largest]], float(sizes[largest]))
