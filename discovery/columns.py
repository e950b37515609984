"""Columns of the design matrix: how the whitened residuals change with each candidate's sizes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import SIZE, difference, residuals

STEP = 1e-2  # prior s.d., of the difference quotient
AT_ONCE = 5e6  # numbers in the columns of several candidates
Moments = tuple[np.ndarray, np.ndarray]  # of a candidate's columns: Gram matrix, (s, s), and pulls, (s, d)
Unsure = list[tuple[slice, np.ndarray]]


class Columns(Protocol):
    """Columns of many candidates, of which a fit needs the number of rows and their products."""

    @property
    def candidates(self) -> list[Candidate]: ...

    @property
    def count(self) -> int: ...

    def moments(self, whitened: np.ndarray, /) -> list[list[Moments]]: ...


@dataclass(frozen=True)
class CandidateColumns:
    """The columns of many candidates in one experiment.

    Attributes:
        projected: columns of each candidate at each point of its grid, whitened and projected, (r + 1, s).
            An effect without a size has one column, its whole change of the residuals.
        unsure: of effects without a size, by number and point, the whitened change of the residuals by one
            s.d. of what the readings do not show of each posture, placement by placement: rows, and (r, m).
    """

    candidates: list[Candidate]
    projected: list[list[np.ndarray]]
    unsure: Mapping[tuple[int, int], Unsure] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Return the number of rows, r + e."""
        return len(self.projected[0][0])

    def moments(self, whitened: np.ndarray) -> list[list[Moments]]:
        """Multiply the columns of each candidate, at each point, by themselves and by others, (r + e, d)."""
        out = [[(column.T @ column, column.T @ whitened) for column in points] for points in self.projected]
        for (k, point), blocks in self.unsure.items():
            gram, pull = out[k][point]
            left = whitened - self.projected[k][point]
            out[k][point] = gram, pull + _gained_by_unsure(blocks, left)
        return out


def _gained_by_unsure(blocks: Unsure, left: np.ndarray) -> np.ndarray:
    """Return what ln of the likelihood of residuals (r + e, d) gains by noise that an effect adds, (d,).

    With U the changes by one s.d. of it, V = I + U U' in place of I.
    """
    gained = np.zeros(left.shape[1])
    for where, columns in blocks:
        pull, spread = columns.T @ left[where], np.eye(columns.shape[1]) + columns.T @ columns
        gained += (
            0.5 * (pull * np.linalg.solve(spread, pull)).sum(axis=0) - 0.5 * np.linalg.slogdet(spread)[1]
        )
    return gained


@dataclass(frozen=True)
class Change:
    """How an experiment changes by a unit of each of a candidate's sizes.

    Attributes:
        values: of the numbered `fields` of `packed`, (m, f, s), or of the residuals if None, (m, 11, s).
    """

    fields: np.ndarray | None
    values: np.ndarray

    def of_residuals(self, linear: LinearModel) -> np.ndarray:
        """Return the change of the residuals about a linear model, (m, 11, s)."""
        if self.fields is None:
            return self.values
        return -(linear.whitening.sensitivity[:, :, self.fields] @ self.values)


# By label and point. It hardly depends on the linear model, so that all rankings share it.
Changes = dict[tuple[str, int], Change]


def candidate_columns(
    linear: LinearModel, candidates: list[Candidate], known: Changes | None = None
) -> CandidateColumns:
    """Compute the columns of many candidates; changes that are not `known` are added there."""
    flat = whitened_columns(linear, candidates, known)
    whole = linear.project(np.concatenate(flat, axis=1))
    parts = iter(np.split(whole, np.cumsum([column.shape[1] for column in flat])[:-1], axis=1))
    unsure = {
        (k, point): list(_unsure_blocks(linear, candidate, point))
        for k, candidate in enumerate(candidates)
        if candidate.effect.mechanism.unsure is not None and not candidate.effect.sizes
        for point in range(len(candidate.settings))
    }
    return CandidateColumns(candidates, [[next(parts) for _ in c.settings] for c in candidates], unsure)


def _unsure_blocks(
    linear: LinearModel, candidate: Candidate, point: int
) -> Iterator[tuple[slice, np.ndarray]]:
    """Whiten the changes by one s.d. of what the readings do not show of each posture of a placement."""
    values = candidate.values(np.zeros(0), point)
    effect, target, white = candidate.effect, candidate.target, linear.whitening
    off = effect.unsure(linear.smoothed, target, values)
    change = None if off is None else difference(effect.remove(linear.smoothed, target, values), off)
    if change is None or not change.any():
        return
    raw = (white.sensitivity @ change[..., None])[..., 0].ravel()
    for where, numbers, factor in white.blocks:
        own = np.equal.outer(numbers // SIZE, np.unique(numbers // SIZE))
        yield where, factor @ (raw[numbers, None] * own)


def candidate_blocks(
    linear: LinearModel, candidates: list[Candidate], known: Changes | None = None
) -> Iterator[CandidateColumns]:
    """Compute the columns of many candidates, as many at a time as memory holds."""
    block: list[Candidate] = []
    numbers = 0
    for candidate in candidates:
        added = len(linear.basis) * len(candidate.settings) * max(len(candidate.effect.sizes), 1)
        if block and numbers + added > AT_ONCE:
            yield candidate_columns(linear, block, known)
            block, numbers = [], 0
        block.append(candidate)
        numbers += added
    if block:
        yield candidate_columns(linear, block, known)


def whitened_columns(
    linear: LinearModel, candidates: list[Candidate], known: Changes | None = None
) -> list[np.ndarray]:
    """Compute the columns of candidates at each point of their grids in turn, whitened, (r, s) each."""
    known = {} if known is None else known
    out = []
    for candidate in candidates:
        for point in range(len(candidate.settings)):
            if not candidate.effect.sizes:
                out.append(_presence_column(linear, candidate, point))
                continue
            key = candidate.label, point
            if key not in known:
                known[key] = _change(linear, candidate, point)
            out.append(known[key].of_residuals(linear))
    return linear.whitening.each(out)


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
    return linear.whitening(_change(linear, candidate, point, sizes).of_residuals(linear))


def presence_column(linear: LinearModel, candidate: Candidate, point: int) -> np.ndarray:
    """Compute how the residuals change with an effect that has no size, whitened, (r, 1)."""
    return linear.whitening(_presence_column(linear, candidate, point))


def _change(linear: LinearModel, candidate: Candidate, point: int, sizes: np.ndarray | None = None) -> Change:
    """Differentiate the experiment with respect to a candidate's sizes."""
    smoothed, prior = linear.smoothed, candidate.prior
    start = np.zeros(len(prior)) if sizes is None else sizes
    if not len(prior):
        return Change(None, np.zeros((len(smoothed), SIZE, 0)))
    before = _removed(smoothed, candidate, start, point)
    steps = STEP * np.diag(prior)
    every = [_removed(smoothed, candidate, start + step, point) for step in steps]
    if all(after.tree is before.tree and after.cells is before.cells for after in every):
        values = np.stack([difference(before, after) for after in every], axis=2) / steps.diagonal()
        changed = np.flatnonzero(values.any(axis=(0, 2)))
        return Change(changed, values[:, changed])
    plain = residuals(before, linear.theta)
    left = np.stack([plain - residuals(after, linear.theta) for after in every], axis=2)
    return Change(None, left / steps.diagonal())


def _presence_column(linear: LinearModel, candidate: Candidate, point: int) -> np.ndarray:
    """Compute how the residuals change with an effect that has no size, (m, 11, 1)."""
    after = _removed(linear.observed, candidate, np.zeros(0), point)
    return (linear.raw_residual - residuals(after, linear.theta))[..., None]


def _removed(observed: Observation, candidate: Candidate, sizes: np.ndarray, point: int) -> Observation:
    return candidate.effect.remove(observed, candidate.target, candidate.values(sizes, point))
