"""The evidence for each candidate alone, and the level of a test among many.

With the noise known, an effect with sizes phi ~ N(0, T^2) explains the projected residual r by its
projected columns G with the Bayes factor ln BF = b'(A + T^-2)^-1 b / 2 - ln|I + T A T| / 2, A = G'G,
b = G'r. A size that cannot be negative has half a normal as its prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2, norm

from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.columns import CandidateColumns

DETECTABLE = 0.5  # smallest singular value times prior s.d. that an experiment can show
DRAWS = 400


def marginal_fit(candidate: Candidate, points: list[np.ndarray], residual: np.ndarray) -> Fitted:
    """Fit one candidate alone to a projected residual, at the best point of its grid.

    Args:
        points: columns of the candidate at each point of its grid, whitened and projected, (r + 1, s).
        residual: whitened and projected, (r + 1,).

    Returns:
        the posterior mean of the sizes; the Bayes factor is averaged over the grid.
    """
    if not candidate.effect.sizes:
        return _marginal_presence(candidate, points, residual)
    prior, positive = candidate.prior, candidate.positive
    best, best_rank, logs = None, (False, -np.inf), []
    for point, column in enumerate(points):
        gram, pull = column.T @ column, column.T @ residual
        scaled = prior[:, None] * gram * prior
        detectable = bool(np.linalg.eigvalsh(scaled).max() > DETECTABLE**2)
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
        logs.append(log if detectable else -np.inf)
        if best is None or (detectable, log) > best_rank:
            p = float(chi2.sf(gain, len(prior))) / (2 if positive.any() else 1) if gain > 0 else 1.0
            best, best_rank = Fitted(candidate, point, sizes, log, covariance, gain, p), (detectable, log)
    assert best is not None
    average = float(np.logaddexp.reduce(logs) - np.log(len(logs)))
    return replace(best, log_bayes_factor=average if best_rank[0] else -np.inf)


def _marginal_presence(candidate: Candidate, points: list[np.ndarray], residual: np.ndarray) -> Fitted:
    """Weigh an effect that has no size but is there or not: ln BF = g'r - g'g / 2."""
    size = np.array([float(g[:, 0] @ g[:, 0]) for g in points])
    detectable = size > DETECTABLE**2  # exchanging a cell with itself changes nothing
    logs = np.array([float(g[:, 0] @ residual) for g in points]) - size / 2
    point = int(np.where(detectable, logs, -np.inf).argmax())
    gain = max(2 * float(logs[point]), 0.0)
    p = float(chi2.sf(gain, 1)) / 2 if gain > 0 else 1.0
    average = -np.inf
    if detectable.any():
        average = float(np.logaddexp.reduce(logs[detectable]) - np.log(detectable.sum()))
    return Fitted(candidate, point, np.zeros(0), average, np.zeros((0, 0)), gain, p)


def ranked(columns: CandidateColumns, residual: np.ndarray) -> list[Fitted]:
    """Fit each candidate alone to a projected residual, (r + 1,); the best first."""
    each = [
        marginal_fit(candidate, points, residual)
        for candidate, points in zip(columns.candidates, columns.projected, strict=True)
    ]
    return sorted(each, key=lambda fitted: -fitted.log_bayes_factor)


def effective_tests(columns: CandidateColumns, rng: np.random.Generator, draws: int = DRAWS) -> float:
    """Estimate the effective number of independent tests among correlated candidates.

    The smallest of n independent p-values has the median 1 - 2^(-1/n). That of the candidates is simulated
    on noise alone and solved for n.
    """
    blocks = [
        (column, candidate)
        for candidate, points in zip(columns.candidates, columns.projected, strict=True)
        for column in points
    ]
    noise = rng.standard_normal((blocks[0][0].shape[0], draws))
    # Largest gain in each draw, by degrees of freedom and number of sides of the test.
    largest: dict[tuple[int, int], np.ndarray] = {}
    for column, candidate in blocks:
        gram, pull = column.T @ column, column.T @ noise
        if not candidate.effect.sizes:
            gain, sides = 2 * pull[0] - gram[0, 0], 1
            gain = np.where(gain > 0, gain, -np.inf)
        elif np.linalg.eigvalsh(candidate.prior[:, None] * gram * candidate.prior).max() > DETECTABLE**2:
            free = np.linalg.pinv(gram, hermitian=True) @ pull
            gain, sides = (pull * free).sum(axis=0), 2
            if candidate.positive.any():
                gain, sides = np.where((free[candidate.positive] > 0).all(axis=0), gain, -np.inf), 1
        else:
            continue
        key = len(gram), sides
        largest[key] = np.maximum(gain, largest.get(key, -np.inf))
    least = np.ones(draws)
    for (dof, sides), gain in largest.items():
        p = np.where(gain > -np.inf, chi2.sf(gain, dof) * sides / 2, 1.0)
        least = np.minimum(least, p)
    # The median is estimated well from few draws. In the tail candidates are less correlated, so that a
    # nominal level of 0.5 % is in fact one of 0.6 to 0.8 %.
    low = float(np.quantile(least, 0.5))
    return float(np.log(0.5) / np.log1p(-low)) if low < 1 else 1.0


def sidak(p: float, tests: float) -> float:
    """Adjust a p-value for the number of independent tests (Sidak 1967)."""
    return float(-np.expm1(tests * np.log1p(-min(p, 1 - 1e-16))))
