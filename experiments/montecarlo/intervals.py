"""Intervals for what a Monte Carlo estimates: its own error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from tulip_testbed.experiments.montecarlo.summary import Calibration
from tulip_testbed.identification.distributions import chi2_ppf, t_ppf


@dataclass(frozen=True)
class Estimates:
    """Estimates of a quantity for p parameters with their intervals, (p,) and (2, p)."""

    value: np.ndarray
    interval: np.ndarray


def relative_bias(found: Calibration, count: int, confidence: float) -> Estimates:
    """Bias over standard error, with Student's interval for the mean error."""
    half = t_ppf((1 + confidence) / 2, count - 1) * mc_error(found, count)
    bias = np.array([found.bias, found.bias - half, found.bias + half])
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = bias / found.standard_error
    return Estimates(relative[0], relative[1:])


def mc_error(found: Calibration, count: int) -> np.ndarray:
    """Monte Carlo standard error of the bias, (p,) [m]."""
    return found.sd / np.sqrt(count)


def standard_error_ratio(found: Calibration, count: int, confidence: float) -> Estimates:
    """S.d. of the errors over the reported standard error, with the chi-square interval of an s.d.

    The interval takes the errors for normal and leaves out the scatter of the reported variance's mean,
    which is far smaller.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = found.sd / found.standard_error
    tail = (1 - confidence) / 2
    factors = np.sqrt((count - 1) / chi2_ppf([1 - tail, tail], count - 1))
    return Estimates(ratio, factors[:, None] * ratio)


def share(counts: np.ndarray, count: int, confidence: float) -> Estimates:
    """Share of runs with the exact binomial interval (Clopper and Pearson 1934)."""
    k, tail = np.asarray(counts), (1 - confidence) / 2
    with np.errstate(invalid="ignore"):
        low, high = (
            scipy.stats.beta.ppf(tail, k, count - k + 1),
            scipy.stats.beta.ppf(1 - tail, k + 1, count - k),
        )
    return Estimates(k / count, np.array([np.where(k == 0, 0.0, low), np.where(k == count, 1.0, high)]))
