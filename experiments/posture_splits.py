"""Splits of measured postures into a part that trains and a part that is predicted."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.measurements import Measurements

FOLDS = 5
BLOCKS = "blocks"
RANGE = re.compile(r"(placement:)?(\d+)(?:-(\d+))?")


@dataclass(frozen=True, eq=False)
class Split:
    """A way to take postures apart, by name, into rows that train and rows that are predicted, by fold."""

    name: str
    folds: tuple[tuple[np.ndarray, np.ndarray], ...]


def clusters(m: Measurements) -> np.ndarray:
    """Return the number of the block that each row belongs to, in the order of time, (m,).

    Blocks are placements, whose errors are common; with a single placement they are runs of successive rows.
    """
    order = np.argsort(m.time, kind="stable") if np.isfinite(m.time).all() else np.arange(len(m))
    number = np.empty(len(m), int)
    if len(np.unique(m.placement)) > 1:
        _, first, inverse = np.unique(m.placement[order], return_index=True, return_inverse=True)
        number[order] = np.argsort(np.argsort(first))[inverse]
        return number
    parts = min(2 * FOLDS, len(m))
    number[order] = np.arange(len(m)) * parts // len(m)
    return number


def by_blocks(m: Measurements) -> Split:
    """Predict contiguous blocks of placements, or single ones of a moving record, from the others."""
    return _parts(m, BLOCKS, FOLDS)


def by_halves(m: Measurements) -> Split:
    """Predict the second half from the first, and the first from the second."""
    return _parts(m, "halves", 2)


def _parts(m: Measurements, name: str, count: int) -> Split:
    block = clusters(m)
    parts = min(count, int(block.max()) + 1)
    # A moving record's blocks are seconds long: those around a block take part in its training.
    moves = m.joint_rates is not None and name == BLOCKS
    part = block % parts if moves else block * parts // (int(block.max()) + 1)
    return Split(name, tuple(_without_shared(m, part != k, part == k) for k in np.unique(part)))


def _without_shared(m: Measurements, train: np.ndarray, test: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Leave what is measured again in the part that is predicted, postures or samples, out of the other."""
    train = train & ~np.isin(m.posture, m.posture[test])
    if m.joint_rates is not None:  # windows overlap
        near = np.abs(m.time[:, None] - m.time[test]) < m.window[:, None]
        train = train & ~near.any(axis=1)
    return np.flatnonzero(train), np.flatnonzero(test)


def stated(m: Measurements, train: Sequence[str], test: Sequence[str]) -> Split:
    """Return the split that a user states: postures "A-B" or "A", or "placement:A-B"; else the rest."""
    both = [_rows(m, name, texts) for name, texts in (("train", train), ("test", test))]
    first = both[0] if train else ~both[1]
    second = both[1] if test else ~both[0]
    for name, rows in (("train", first), ("test", second)):
        if not rows.any():
            raise InputError(f"{name}: found no posture that the other part leaves, expected one or more")
    if len(common := np.intersect1d(m.posture[first], m.posture[second])):
        raise InputError(f"train, test: found postures {listed(common)} in both, expected each in one")
    return Split("stated", ((np.flatnonzero(first), np.flatnonzero(second)),))


def _rows(m: Measurements, name: str, texts: Sequence[str]) -> np.ndarray:
    chosen = np.zeros(len(m), bool)
    for text in texts:
        for part in text.split(","):
            found = RANGE.fullmatch(part.strip())
            if not found:
                raise InputError(
                    f"{name}: found '{shortened(part)}', expected postures such as 1-40 or placements such "
                    "as placement:1-8"
                )
            numbers = m.placement if found[1] else m.posture
            low, high = int(found[2]), int(found[3] or found[2])
            rows = (numbers >= low) & (numbers <= high)
            if not rows.any():
                raise InputError(
                    f"{name}: found no row of {part.strip()}, expected numbers of the measurements"
                )
            chosen |= rows
    return chosen
