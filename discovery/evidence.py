"""How well every candidate explains what is left, and how much it could have been.

With the noise known, an effect with sizes phi ~ N(0, T^2) explains the projected residual r by its
projected columns G with the Bayes factor ln BF = b'(A + T^-2)^-1 b / 2 - ln|I + T A T| / 2, A = G'G,
b = G'r. A size that cannot be negative has half a normal as its prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from tulip_testbed.discovery.candidates import Candidate, columns, whole_change
from tulip_testbed.discovery.linear_model import Linear

VISIBLE = 0.5  # least singular value times prior s.d. of what could be observed
DRAWS = 400


@dataclass(frozen=True)
class Score:
    """What one candidate makes of a residual.

    Attributes:
        candidate, point: which, at its best grid point.
        sizes, covariance: posterior mean and covariance, (s,) and (s, s).
        gain: of chi-square by the best sizes.
        p: probability of as large a gain without the effect, of this candidate's best point alone.
        log_bayes_factor: against no effect, averaged over its grid.
        visible: whether it could be observed at all.
    """

    candidate: Candidate
    point: int
    sizes: np.ndarray
    covariance: np.ndarray
    gain: float
    p: float
    log_bayes_factor: float
    visible: bool


@dataclass(frozen=True)
class Field:
    """All candidates' columns in an experiment.

    Attributes:
        candidates: those of the catalogue.
        projected: columns of every candidate at every grid point, whitened and projected, (r + 1, s).
    """

    candidates: list[Candidate]
    projected: list[list[np.ndarray]]


def field(linear: Linear, among: list[Candidate]) -> Field:
    """Columns of many candidates."""
    raw = [
        [(columns if c.effect.sizes else whole_change)(linear, c, point) for point in range(len(c.settings))]
        for c in among
    ]
    flat = [column for points in raw for column in points]
    sizes = [column.shape[1] for column in flat]
    whole = linear.project(np.concatenate(flat, axis=1))
    parts = iter(np.split(whole, np.cumsum(sizes)[:-1], axis=1))
    return Field(among, [[next(parts) for _ in points] for points in raw])


def score(candidate: Candidate, points: list[np.ndarray], residual: np.ndarray) -> Score:
    """One candidate against a projected residual, (r + 1,)."""
    if not candidate.effect.sizes:
        return _score_of_presence(candidate, points, residual)
    prior, positive = candidate.prior, candidate.positive
    best, logs = None, []
    for point, column in enumerate(points):
        gram, pull = column.T @ column, column.T @ residual
        scaled = prior[:, None] * gram * prior
        visible = bool(np.linalg.eigvalsh(scaled).max() > VISIBLE**2)
        inverse = np.linalg.inv(np.eye(len(prior)) + scaled)
        covariance = prior[:, None] * inverse * prior
        sizes = covariance @ pull
        _, volume = np.linalg.slogdet(np.eye(len(prior)) + scaled)
        log = 0.5 * float(pull @ sizes) - 0.5 * volume
        free = np.linalg.pinv(gram, hermitian=True) @ pull
        gain = float(pull @ free)
        if positive.any():
            # the part of the posterior that is allowed, over the same part of the prior (a half)
            spread = np.sqrt(np.diag(covariance))
            log += float((norm.logcdf(sizes / spread) + np.log(2))[positive].sum())
            gain = gain if (free[positive] > 0).all() else 0.0
            sizes = np.where(positive, np.maximum(sizes, 0.0), sizes)
        logs.append(log if visible else -np.inf)
        if best is None or (visible, log) > (best.visible, best.log_bayes_factor):
            p = float(chi2.sf(gain, len(prior))) / (2 if positive.any() else 1) if gain > 0 else 1.0
            best = Score(candidate, point, sizes, covariance, gain, p, log, visible)
    assert best is not None
    average = float(np.logaddexp.reduce(logs) - np.log(len(logs)))
    return replace(best, log_bayes_factor=average if best.visible else -np.inf)


def _score_of_presence(candidate: Candidate, points: list[np.ndarray], residual: np.ndarray) -> Score:
    """Of an effect without a size, which is there or not: ln BF = g'r - g'g / 2."""
    size = np.array([float(g[:, 0] @ g[:, 0]) for g in points])
    observed = size > VISIBLE**2  # a cell exchanged with itself is nothing
    logs = np.array([float(g[:, 0] @ residual) for g in points]) - size / 2
    point = int(np.where(observed, logs, -np.inf).argmax())
    gain = max(2 * float(logs[point]), 0.0)
    average = (
        float(np.logaddexp.reduce(logs[observed]) - np.log(observed.sum())) if observed.any() else -np.inf
    )
    p = float(chi2.sf(gain, 1)) / 2 if gain > 0 else 1.0
    return Score(candidate, point, np.zeros(0), np.zeros((0, 0)), gain, p, average, bool(observed.any()))


def scores(found: Field, residual: np.ndarray) -> list[Score]:
    """All candidates, the best first."""
    each = [score(c, points, residual) for c, points in zip(found.candidates, found.projected, strict=True)]
    return sorted(each, key=lambda s: -s.log_bayes_factor)


def family(found: Field, rng: np.random.Generator, draws: int = DRAWS) -> float:
    """How many independent tests the field is worth: from the smallest p among noise alone.

    The smallest of n independent p has the median 1 - 2^(-1/n); candidates overlap, so n is less than
    their number.
    """
    blocks = [
        (column, candidate)
        for candidate, points in zip(found.candidates, found.projected, strict=True)
        for column in points
    ]
    noise = rng.standard_normal((blocks[0][0].shape[0], draws))
    least = np.ones(draws)
    for column, candidate in blocks:
        gram, pull = column.T @ column, column.T @ noise
        if not candidate.effect.sizes:
            gain = 2 * pull[0] - gram[0, 0]
            least = np.minimum(least, np.where(gain > 0, chi2.sf(np.maximum(gain, 0), 1) / 2, 1.0))
            continue
        if np.linalg.eigvalsh(candidate.prior[:, None] * gram * candidate.prior).max() <= VISIBLE**2:
            continue
        free = np.linalg.pinv(gram, hermitian=True) @ pull
        gain = (pull * free).sum(axis=0)
        p = chi2.sf(gain, len(gram))
        if candidate.positive.any():
            p = np.where((free[candidate.positive] > 0).all(axis=0), p / 2, 1.0)
        least = np.minimum(least, p)
    # Matched at the median, which few draws tell well; in the tail candidates overlap less, so that a
    # level of 0.5 % is in truth one of 0.6 to 0.8 %.
    low = float(np.quantile(least, 0.5))
    return float(np.log(0.5) / np.log1p(-low)) if low < 1 else 1.0


def adjusted(p: float, tests: float) -> float:
    """Probability of one as small among so many tests."""
    return float(-np.expm1(tests * np.log1p(-min(p, 1 - 1e-16))))
