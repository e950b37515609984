"""Identifiability: find the parameters that the postures do not determine.

Measured angles hide a rank deficiency: a joint that never moved still has encoder noise, so the regressor
has full rank and the estimate reflects that noise. Therefore each direction v in parameter space is judged
by energy: |H v|^2 is its excitation by the postures, and |B v|^2 the part that the encoders' errors alone
produce, where B is one s.d. of each encoder times the derivative of H by its angle. If
|B v|^2 / (|H v|^2 + |B v|^2) exceeds `MOST_BLUR`, the direction counts as undetermined. The ratio is about
0.5 for a joint at rest (H is then one draw of B), and 0.001 to 0.1 for the weakest direction of a usable
plan.
"""

import numpy as np

from tulip_testbed.base.errors import InputError, listed

MOST_BLUR = 0.25
NEGLIGIBLE = 0.05  # of the largest weight in a combination; smaller weights are not named
MOST_COMBINATIONS = 4  # that are written out
MOST_TERMS = 4  # of a combination that are written out


def require_identifiable(
    matrix: np.ndarray, names: tuple[str, ...], source: str, blur: np.ndarray | None = None
) -> None:
    """Refuse a regressor, (r, p), that leaves a parameter open by a blur, (k, p), or by rounding if None."""
    rows, columns = matrix.shape
    if rows <= columns:
        raise InputError(
            f"{source}: found {rows // 2} postures ({rows} data points), expected at least "
            f"{columns // 2 + 1} for {columns} base parameters; measure more postures"
        )
    if len(free := undetermined_directions(matrix, blur)):
        known = len(names) - len(free)
        raise InputError(
            f"{source}: the postures determine {known} of {len(names)} parameters; "
            f"{describe_combinations(free, names)}"
        )


def undetermined_directions(matrix: np.ndarray, blur: np.ndarray | None = None) -> np.ndarray:
    """Return a basis of the directions that H, (r, p), does not determine, (d, p), d = 0 at full rank.

    The basis follows from the singular values of H against [H; B] (quotient singular value decomposition),
    which do not depend on a scaling of columns or on pivoting. Without a blur B, (k, p), only rounding errors
    count.
    """
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = scale.max() or 1.0
    columns = matrix.shape[1]
    rounding = max(matrix.shape) * np.finfo(float).eps * np.diag(scale.max() / scale)
    errors = rounding if blur is None else np.vstack([blur / scale, rounding])
    orthogonal, triangle = np.linalg.qr(np.vstack([matrix / scale, errors]))
    _, share, turned = np.linalg.svd(np.linalg.qr(orthogonal[: len(matrix)], mode="r"))
    share = np.append(share, np.zeros(columns - len(share)))
    weak = turned[share**2 < 1 - MOST_BLUR]
    return np.linalg.solve(triangle, weak.T).T / scale


def weakly_known(covariance: np.ndarray, most: float) -> np.ndarray:
    """Return the directions whose standard error by a covariance, (p, p) [m2], exceeds `most` [m], (d, p)."""
    variance, directions = np.linalg.eigh(covariance)
    return directions[:, variance > most**2].T


def labels(numbers: np.ndarray, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names with their numbers, such as "right_foot.y (13)"."""
    return tuple(f"{name} ({number})" for name, number in zip(names, numbers, strict=True))


def describe_combinations(directions: np.ndarray, names: tuple[str, ...]) -> str:
    """Describe the parameters and combinations in a subspace of undetermined directions, (d, p)."""
    free = reduced_basis(directions)
    texts = []
    for members, rows in _groups(free):
        named = [names[k] for k in members]
        if len(members) == 1:
            texts.append(f"{named[0]} is not determined")
            continue
        combinations = [_combination(free[row], names) for row in rows]
        spelt = listed(combinations) if len(rows) <= MOST_COMBINATIONS else f"{len(rows)} combinations"
        texts.append(f"{', '.join(named[:-1])} and {named[-1]} are not determined separately (free: {spelt})")
    return "; ".join(texts)


def reduced_basis(directions: np.ndarray) -> np.ndarray:
    """Return the basis of the same subspace in reduced echelon form from the last column, (d, p).

    Each vector has a one at its own parameter and zeros at the others'. These are the last possible
    parameters in a fixed order; no pivot depends on rounding errors between equal numbers.
    """
    basis = np.linalg.qr(directions.T)[0].T
    least = 0.5 / np.sqrt(basis.shape[1])
    rest, own = basis, []
    for column in reversed(range(basis.shape[1])):
        part = rest[:, column]
        if len(rest) and np.linalg.norm(part) > least:
            own.append(column)
            rest = np.linalg.qr(part[:, None], mode="complete")[0][:, 1:].T @ rest
    free = np.linalg.solve(basis[:, own], basis)
    free[np.abs(free) < NEGLIGIBLE * np.abs(free).max(axis=1, keepdims=True)] = 0.0
    return free


def _groups(free: np.ndarray) -> list[tuple[list[int], list[int]]]:
    """Group the parameters that free combinations link, each with the rows of these combinations."""
    groups: list[tuple[set[int], list[int]]] = []
    for row, weights in enumerate(free):
        members, rows = set(np.flatnonzero(weights).tolist()), [row]
        for other in [group for group in groups if group[0] & members]:
            groups.remove(other)
            members, rows = members | other[0], other[1] + rows
        groups.append((members, rows))
    return sorted((sorted(members), rows) for members, rows in groups)


def _combination(weights: np.ndarray, names: tuple[str, ...]) -> str:
    """Return a combination as text, such as "right_foot.y - 0.98 right_ankle.y", with its largest terms."""
    terms = []
    largest = sorted(np.flatnonzero(weights), key=lambda k: -abs(weights[k]))[:MOST_TERMS]
    for k in sorted(largest, key=lambda k: -weights[k]):
        size = f"{abs(weights[k]):.2g}"
        factor = "" if size == "1" else f"{size} "
        terms.append(f"{'-' if weights[k] < 0 else '+'} {factor}{names[k]}")
    smaller = np.count_nonzero(weights) - len(terms)
    more = f" and {smaller} smaller {'terms' if smaller > 1 else 'term'}" if smaller else ""
    return " ".join(terms).removeprefix("+ ") + more
