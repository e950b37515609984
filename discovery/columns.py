"""Columns of the design matrix: how the whitened residuals change with each candidate's sizes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import SIZE, difference, residuals

STEP = 1e-2  # prior s.d., of the difference quotient
AT_ONCE = 2e7  # numbers in the columns of several candidates


@dataclass(frozen=True)
class CandidateColumns:
    """The columns of many candidates in one experiment.

    Attributes:
        projected: columns of each candidate at each point of its grid, whitened and projected, (r + 1, s).
            An effect without a size has one column, its whole change of the residuals.
    """

    candidates: list[Candidate]
    projected: list[list[np.ndarray]]


def candidate_columns(linear: LinearModel, candidates: list[Candidate]) -> CandidateColumns:
    """Compute the columns of many candidates."""
    flat = whitened_columns(linear, candidates)
    whole = linear.project(np.concatenate(flat, axis=1))
    parts = iter(np.split(whole, np.cumsum([column.shape[1] for column in flat])[:-1], axis=1))
    return CandidateColumns(candidates, [[next(parts) for _ in c.settings] for c in candidates])


def candidate_blocks(linear: LinearModel, candidates: list[Candidate]) -> Iterator[CandidateColumns]:
    """Compute the columns of many candidates, as many at a time as memory holds."""
    block: list[Candidate] = []
    numbers = 0
    for candidate in candidates:
        added = len(linear.basis) * len(candidate.settings) * max(len(candidate.effect.sizes), 1)
        if block and numbers + added > AT_ONCE:
            yield candidate_columns(linear, block)
            block, numbers = [], 0
        block.append(candidate)
        numbers += added
    if block:
        yield candidate_columns(linear, block)


def whitened_columns(linear: LinearModel, candidates: list[Candidate]) -> list[np.ndarray]:
    """Compute the columns of candidates at each point of their grids in turn, whitened, (r, s) each."""
    return linear.whitening.each(
        [
            (_size_columns if c.effect.sizes else _presence_column)(linear, c, point)
            for c in candidates
            for point in range(len(c.settings))
        ]
    )


def effect_columns(
    linear: LinearModel, candidate: Candidate, point: int, sizes: np.ndarray | None = None
) -> np.ndarray:
    """Differentiate the residuals with respect to a candidate's sizes.

    Args:
        point: of the candidate's grid.
        sizes: at which the derivative is taken, (s,); zero if None.

    Returns:
        whitened columns, (r, s) per unit of each size.
    """
    return linear.whitening(_size_columns(linear, candidate, point, sizes))


def presence_column(linear: LinearModel, candidate: Candidate, point: int) -> np.ndarray:
    """Compute how the residuals change with an effect that has no size, whitened, (r, 1)."""
    return linear.whitening(_presence_column(linear, candidate, point))


def _size_columns(
    linear: LinearModel, candidate: Candidate, point: int, sizes: np.ndarray | None = None
) -> np.ndarray:
    """Differentiate the residuals with respect to a candidate's sizes, (m, 11, s)."""
    smoothed, prior = linear.smoothed, candidate.prior
    out = np.zeros((len(smoothed), SIZE, len(prior)))
    start = np.zeros(len(prior)) if sizes is None else sizes
    before = _removed(smoothed, candidate, start, point) if len(prior) else smoothed
    for k, step in enumerate(STEP * prior):
        after = _removed(smoothed, candidate, start + step * (np.arange(len(start)) == k), point)
        if after.tree is before.tree and after.cells is before.cells:
            change = difference(before, after) / step
            out[..., k] = -(linear.whitening.sensitivity @ change[..., None])[..., 0]
        else:
            out[..., k] = -((residuals(after, linear.theta) - residuals(before, linear.theta)) / step)
    return out


def _presence_column(linear: LinearModel, candidate: Candidate, point: int) -> np.ndarray:
    """Compute how the residuals change with an effect that has no size, (m, 11, 1)."""
    after = _removed(linear.observed, candidate, np.zeros(0), point)
    return (linear.raw_residual - residuals(after, linear.theta))[..., None]


def _removed(observed: Observation, candidate: Candidate, sizes: np.ndarray, point: int) -> Observation:
    return candidate.effect.remove(observed, candidate.target, candidate.values(sizes, point))
