"""Measures of an estimate's accuracy (eqs 12, 13 and 15)."""

from dataclasses import dataclass

import numpy as np

WELL_IDENTIFIED = 15.0  # % relative standard error (Khalil and Dombre 2004, as in the paper)
HIGH_CORRELATION = 0.85  # the paper's level


def standard_errors(covariance: np.ndarray) -> np.ndarray:
    """Return the standard errors, the roots of the covariance's diagonal, (p,)."""
    return np.sqrt(np.diag(covariance))


def relative_standard_errors(value: np.ndarray, standard_error: np.ndarray) -> np.ndarray:
    """Return the relative standard errors (eq. 13), (p,) [%]; infinite or NaN for a zero estimate."""
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        return 100 * standard_error / np.abs(value)


def correlations(covariance: np.ndarray) -> np.ndarray:
    """Return the correlations (eq. 15), (p, p); NaN where the covariance is zero."""
    scale = standard_errors(covariance)
    with np.errstate(invalid="ignore"):
        return covariance / np.outer(scale, scale)


def high_correlations(
    covariance: np.ndarray, numbers: np.ndarray, level: float
) -> list[tuple[int, int, float]]:
    """List the pairs (a, b, rho) with |rho| above a level, a < b in the paper's numbers."""
    rho = correlations(covariance)
    pairs = np.argwhere(np.triu(np.abs(rho) > level, k=1))
    return [(int(numbers[a]), int(numbers[b]), float(rho[a, b])) for a, b in pairs]


@dataclass(frozen=True)
class ResidualNorms:
    """Distance between measured and estimated centre of pressure over the postures [m] (eq. 12, Fig. 4)."""

    mean: float
    sd: float
    max: float


def residual_norms(residual: np.ndarray) -> ResidualNorms:
    """Compute statistics of the norms of the residual, (2m,) [m], over the postures."""
    norms = np.linalg.norm(residual.reshape(-1, 2), axis=1)
    return ResidualNorms(float(norms.mean()), float(norms.std(ddof=1)), float(norms.max()))
