"""Sums that never hold all runs: moments, counts and histograms, one pass each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

BINS = 1000


@dataclass(frozen=True)
class Moments:
    """Of k quantities over `count` rows: mean, corrected sum of squares, extremes, all (k,)."""

    count: int
    mean: np.ndarray
    squares: np.ndarray
    least: np.ndarray
    most: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """With n - 1, (k,); NaN for a single row."""
        return np.sqrt(self.squares / (self.count - 1)) if self.count > 1 else np.full(len(self.mean), np.nan)


def moments(chunks: Iterable[np.ndarray], size: int) -> Moments:
    """Moments of rows that come in chunks (n, size).

    Row by row (Welford 1962), so the last bit does not depend on how the rows were cut into chunks.
    """
    count, mean, squares = 0, np.zeros(size), np.zeros(size)
    least, most = np.full(size, np.inf), np.full(size, -np.inf)
    for chunk in chunks:
        for row in chunk:
            count += 1
            step = row - mean
            mean = mean + step / count
            squares = squares + step * (row - mean)
        if len(chunk):
            least, most = np.minimum(least, chunk.min(axis=0)), np.maximum(most, chunk.max(axis=0))
    return Moments(count, mean if count else np.full(size, np.nan), squares, least, most)


def histogram(chunks: Iterable[np.ndarray], found: Moments) -> np.ndarray:
    """Return counts of rows in `BINS` equal bins between the extremes of each quantity, (k, BINS)."""
    counts = np.zeros((len(found.mean), BINS), dtype=np.int64)
    width = np.where(found.most > found.least, found.most - found.least, 1.0)
    columns = np.arange(len(found.mean))
    for chunk in chunks:
        # A quantity that is NaN somewhere has NaN for extremes, and so for quantiles.
        place = np.nan_to_num(BINS * (chunk - found.least) / width).clip(0, BINS - 1).astype(int)
        np.add.at(counts, (columns[None], place), 1)
    return counts


def quantiles(counts: np.ndarray, found: Moments, levels: tuple[float, ...]) -> np.ndarray:
    """Quantiles from a histogram, linear within its bins, (levels, k).

    Off by at most a bin: a thousandth of the range.
    """
    edges = np.linspace(found.least, found.most, BINS + 1)
    below = np.concatenate([np.zeros((len(counts), 1)), np.cumsum(counts, axis=1)], axis=1) / found.count
    per_quantity = [np.interp(levels, b, edges[:, k]) for k, b in enumerate(below)]
    return np.transpose(per_quantity)
