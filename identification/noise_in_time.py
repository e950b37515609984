"""Noise of a moving record that lasts: a stationary process of every segment, and white noise.

The noise of samples has two parts: one that is white, and one with the correlation exp(-|t - t'| / T), an
Ornstein-Uhlenbeck process. A row is the mean of a window in which a sample weighs (1 - u^2)^2; the
correlation of two rows is the mean over both windows. Of a row's variance the share s lasts. Rows times the
inverse of a root of the matrix of correlations are uncorrelated. A residual that some rows do not have is
decorrelated over the others. Encoders alone show whether the legs close, and more of their noise lasts than
of the cells': these residuals have a share of their own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

MOST_ROWS = 240  # of a segment that are looked at together, for the sake of time and memory
_PLACES = np.linspace(-1.0, 1.0, 81)
_WEIGHTS = (1 - _PLACES**2) ** 2
LAGS = np.linspace(-2.0, 2.0, 161)  # of two samples, each in its window, in half windows
OFTEN = np.convolve(_WEIGHTS, _WEIGHTS)  # how much pairs of samples with these lags weigh


@dataclass(frozen=True)
class NoiseInTime:
    """How the noise of rows is correlated in time.

    Attributes:
        share: of its variance that lasts, 0 to 1. seconds: for how long [s].
        closure: share of the residuals of the legs' closure; None: the same.
    """

    share: float = 0.0
    seconds: float = 1.0
    closure: float | None = None

    def of_closure(self) -> Self:
        """Return how that of the legs' closure is correlated."""
        return self if self.closure is None else replace(self, share=self.closure)

    def correlation(self, time: np.ndarray, window: float) -> np.ndarray:
        """Return the correlation of rows at these times, means over windows of this length, (n, n)."""
        apart = np.round(np.abs(time[:, None] - time), 6)  # s
        lag, number = np.unique(apart, return_inverse=True)
        white = np.interp(2 * lag / window, LAGS, OFTEN / OFTEN.max(), right=0.0)
        lasting = np.exp(-np.abs(np.append(0.0, lag)[:, None] + window / 2 * LAGS) / self.seconds) @ OFTEN
        each = self.share * lasting[1:] / lasting[0] + (1 - self.share) * white
        return each[number.reshape(apart.shape)]


WHITE = NoiseInTime()


@dataclass(frozen=True, eq=False)
class Decorrelation:
    """Linear combinations of rows whose noise is uncorrelated in time.

    Attributes:
        blocks: numbers of the rows that belong together, of b stretches alike, (b, n), of the residuals that
            all of them have, (k,), the rows' correlation and the lower triangular matrix that makes them
            uncorrelated, (n, n) each.
    """

    blocks: tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], ...]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the combinations of values, (m, r, ...)."""
        return self._times(values, [factor for *_, factor in self.blocks])

    def back(self, values: np.ndarray) -> np.ndarray:
        """Return values times the transpose, (m, r, ...)."""
        return self._times(values, [factor.T for *_, factor in self.blocks])

    def correlated(self, values: np.ndarray) -> np.ndarray:
        """Return values times the correlation, (m, r, ...)."""
        return self._times(values, [correlation for *_, correlation, _ in self.blocks])

    @property
    def effective_rows(self) -> float:
        """Return how many rows with independent noise would determine a constant equally well."""
        always = ((len(rows), factor) for rows, residuals, _, factor in self.blocks if 0 in residuals)
        return float(sum(count * (factor.sum(axis=1) ** 2).sum() for count, factor in always))

    def log_volume(self, used: np.ndarray) -> float:
        """Return ln of the determinant of the combinations of all residuals in use, (m, r) bool."""
        return sum(
            float(used[rows[..., None], residuals].any(axis=1).sum() * np.log(np.diag(factor)).sum())
            for rows, residuals, _, factor in self.blocks
        )

    def _times(self, values: np.ndarray, matrices: list[np.ndarray]) -> np.ndarray:
        out = values.copy()
        for (rows, residuals, *_), matrix in zip(self.blocks, matrices, strict=True):
            at = rows[..., None], residuals
            some = values[at]
            out[at] = (matrix @ some.reshape(*rows.shape, -1)).reshape(some.shape)
        return out


def decorrelation(
    rows: tuple[np.ndarray, float, np.ndarray],
    parts: Sequence[tuple[np.ndarray, NoiseInTime, list[int]]],
) -> Decorrelation:
    """Return what makes rows uncorrelated.

    Args:
        rows: time of each, (m,) [s], length [s], and which residuals it has, (m, r) bool.
        parts: of some residuals the number of the segment beyond which their noise does not last, of every
            row, (m,), how it lasts, and these residuals.
    """
    time, window, used = rows
    alike = dict[tuple[bytes, NoiseInTime, tuple[int, ...]], list[np.ndarray]]()
    for segment, lasting, residuals in parts:
        for together in _together(time, segment):
            having = dict[bytes, list[int]]()
            for residual in residuals:
                having.setdefault(used[together, residual].tobytes(), []).append(residual)
            for several in having.values():
                there = together[used[together, several[0]]]
                since = np.round(time[there] - time[there[:1]], 6)
                alike.setdefault((since.tobytes(), lasting, tuple(several)), []).append(there)
    blocks = []
    for (_, lasting, residuals), stretches in alike.items():
        numbers = np.array(stretches)
        if numbers.size:
            correlation = lasting.correlation(time[numbers[0]], window)
            factor = np.linalg.inv(np.linalg.cholesky(correlation))
            blocks.append((numbers, np.array(residuals), correlation, factor))
    return Decorrelation(tuple(blocks))


def apart(time: np.ndarray, segment: np.ndarray, seconds: float) -> np.ndarray:
    """Return rows of each segment that are at least so far apart, in order, (k,)."""
    out = []
    for number in np.unique(segment):
        last = -np.inf
        for row in np.flatnonzero(segment == number).tolist():
            if time[row] - last >= seconds - 1e-6:
                out.append(row)
                last = time[row]
    return np.array(out, int)


def _together(time: np.ndarray, segment: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the rows of each segment, a long one in pieces."""
    order = np.lexsort((time, segment))
    for rows in np.split(order, 1 + np.flatnonzero(np.diff(segment[order]))):
        yield from np.array_split(rows, -(-len(rows) // MOST_ROWS))
