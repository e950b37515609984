"""How large an effect must be for an experiment to show it, and what it does to the parameters unseen."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy

from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.identification.distributions import chi2_isf

POWER = 0.9


@cache
def noncentrality(freedom: int, level: float, power: float = POWER) -> float:
    """Of chi-square that exceeds its `level` quantile with probability `power`."""
    bound = chi2_isf(level, freedom)

    def missing(noncentral: float) -> float:
        return float(scipy.stats.ncx2.sf(bound, freedom, noncentral)) - power

    return float(scipy.optimize.brentq(missing, 1e-6, 1e4))  # pyrefly: ignore


def single_level(level: float, tests: float) -> float:
    """Level of one test among many that together keep `level`."""
    return float(-np.expm1(np.log1p(-level) / tests))


def least_multiple(candidate: Candidate, visible: float, level: float) -> float:
    """Least size that is found with 90 % probability, in prior s.d.; infinite: never.

    Args:
        visible: see `Fitted`.
        level: of a single test.
    """
    one_sided = 2 * level if candidate.positive.any() else level
    wanted = np.sqrt(noncentrality(len(candidate.prior), min(one_sided, 0.5)))
    return float(wanted / visible) if visible > 0 else np.inf


def detectable_size(
    candidate: Candidate, projected: np.ndarray, level: float, direction: np.ndarray | None = None
) -> float:
    """Least size that is found with 90 % probability [of the size's unit]; infinite: never.

    Args:
        projected: the candidate's columns, whitened and projected, (r + 1, s).
        level: of a single test.
        direction: of several sizes, (s,), as multiples; the first one's alone if None.
    """
    if not candidate.effect.sizes:
        return 1.0
    along = np.eye(projected.shape[1])[0] if direction is None else direction
    return least_multiple(candidate, float(np.linalg.norm(projected @ along)), level)
