"""Which parameters the postures cannot tell apart.

Measured angles hide a missing rank: a joint that never moved still shows its encoder's noise, so the
regressor has full rank and the estimate is that noise's. Hence directions in parameter space are
judged by energy. |H v|^2 is what the postures show of a direction v; the encoders' errors alone put
|B v|^2 into it, B being one s.d. of each encoder times the derivative of H by its angle. Where
|B v|^2 / (|H v|^2 + |B v|^2) exceeds `MOST_BLUR`, the direction counts as not shown at all. A joint
at rest has about 0.5 (H then is one draw of B), the weakest direction of a usable plan 0.001 to 0.1.
"""

from __future__ import annotations

import numpy as np

from tulip_testbed.sim.errors import InputError, listed

MOST_BLUR = 0.25
NEGLIGIBLE = 0.05  # of the largest weight in a combination: not worth naming
MOST_COMBINATIONS = 4  # to spell out
MOST_TERMS = 4  # of a combination to spell out


def require_identifiable(
    matrix: np.ndarray, names: tuple[str, ...], source: str, blur: np.ndarray | None = None
) -> None:
    """Refuse a regressor that does not determine every parameter.

    Args:
        matrix: H, (r, p).
        names: of the p parameters.
        blur: B, (k, p); None: rounding errors alone.

    Raises:
        InputError: names the parameters that cannot be told apart, group by group.
    """
    if len(free := undetermined_directions(matrix, blur)):
        known = len(names) - len(free)
        raise InputError(
            f"{source}: the postures determine {known} of {len(names)} parameters; "
            f"{describe_combinations(free, names)}"
        )


def undetermined_directions(matrix: np.ndarray, blur: np.ndarray | None = None) -> np.ndarray:
    """Directions that H does not show, (d, p), d = 0 where it has full rank.

    By the singular values of H against [H; B] (their quotient singular value decomposition), which
    no scaling of columns and no pivoting changes.

    Args:
        matrix: H, (r, p).
        blur: B, (k, p); None: rounding errors alone.
    """
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = scale.max() or 1.0
    columns = matrix.shape[1]
    rounding = max(matrix.shape) * np.finfo(float).eps * np.diag(scale.max() / scale)
    errors = rounding if blur is None else np.vstack([blur / scale, rounding])
    orthogonal, triangle = np.linalg.qr(np.vstack([matrix / scale, errors]))
    _, shown, turned = np.linalg.svd(np.linalg.qr(orthogonal[: len(matrix)], mode="r"))
    shown = np.append(shown, np.zeros(columns - len(shown)))
    weak = turned[shown**2 < 1 - MOST_BLUR]
    return np.linalg.solve(triangle, weak.T).T / scale


def weakly_known(covariance: np.ndarray, most: float) -> np.ndarray:
    """Directions whose standard error exceeds `most` [m], (d, p).

    Args:
        covariance: of the estimate, (p, p) [m2].
    """
    variance, directions = np.linalg.eigh(covariance)
    return directions[:, variance > most**2].T


def labels(numbers: np.ndarray, names: tuple[str, ...]) -> tuple[str, ...]:
    """right_foot.y (13)."""
    return tuple(f"{name} ({number})" for name, number in zip(names, numbers, strict=True))


def describe_combinations(directions: np.ndarray, names: tuple[str, ...]) -> str:
    """In words: which parameters a subspace of directions mixes, and which combinations are free.

    Args:
        directions: a basis, (d, p).
    """
    free = reduced_basis(directions)
    texts = []
    for members, rows in _groups(free):
        named = [names[k] for k in members]
        if len(members) == 1:
            texts.append(f"they say nothing of {named[0]}")
            continue
        combinations = [_combination(free[row], names) for row in rows]
        spelt = listed(combinations) if len(rows) <= MOST_COMBINATIONS else f"{len(rows)} combinations"
        texts.append(f"they cannot tell apart {', '.join(named[:-1])} and {named[-1]} (free: {spelt})")
    return "; ".join(texts)


def reduced_basis(directions: np.ndarray) -> np.ndarray:
    """The basis of the same subspace with a one at its own parameter each and zeros at the others', (d, p).

    These are the last parameters that can be, in a fixed order; no pivot depends on which of
    several equal numbers is the largest by a rounding error.
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
    """Parameters that free combinations link, and those combinations' rows; by first parameter."""
    groups: list[tuple[set[int], list[int]]] = []
    for row, weights in enumerate(free):
        members, rows = set(np.flatnonzero(weights).tolist()), [row]
        for other in [group for group in groups if group[0] & members]:
            groups.remove(other)
            members, rows = members | other[0], other[1] + rows
        groups.append((members, rows))
    return sorted((sorted(members), rows) for members, rows in groups)


def _combination(weights: np.ndarray, names: tuple[str, ...]) -> str:
    """right_foot.y - 0.98 right_ankle.y; of many terms the largest."""
    terms = []
    largest = sorted(np.flatnonzero(weights), key=lambda k: -abs(weights[k]))[:MOST_TERMS]
    for k in sorted(largest, key=lambda k: -weights[k]):
        size = f"{abs(weights[k]):.2g}"
        factor = "" if size == "1" else f"{size} "
        terms.append(f"{'-' if weights[k] < 0 else '+'} {factor}{names[k]}")
    smaller = np.count_nonzero(weights) - len(terms)
    more = f" and {smaller} smaller {'terms' if smaller > 1 else 'term'}" if smaller else ""
    return " ".join(terms).removeprefix("+ ") + more
