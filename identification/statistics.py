"""Measures of an estimate's accuracy (eqs 12, 13 and 15), and degrees of freedom for intervals and tests."""

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


def satterthwaite(
    variance: np.ndarray, slopes: np.ndarray, uncertainty: np.ndarray, most: float
) -> np.ndarray:
    """Return the degrees of freedom of variances that depend on estimated scales, 2 v^2 / var(v).

    Satterthwaite (1946), Giesbrecht and Burns (1985).

    Args:
        variance: (n,). slopes: its derivatives by the logarithms of the scales, (k, n).
        uncertainty: covariance of those logarithms, (k, k). most: the largest number of degrees of freedom.
    """
    doubt = np.einsum("ki,kl,li->i", slopes, uncertainty, slopes)
    least = np.maximum(2 * variance**2 / max(most, 1.0), np.finfo(float).tiny)
    return 2 * variance**2 / np.maximum(doubt, least)


def of_f_test(covariance: np.ndarray, slopes: np.ndarray, uncertainty: np.ndarray, most: float) -> float:
    """Return the denominator's degrees of freedom of an F test of all parameters, e' V^-1 e / p.

    The test is a sum over the principal axes of V, each with degrees of freedom of its own; the F
    distribution is that with the same mean (Fai and Cornelius 1996). Axes with two and fewer have no mean;
    where too many are so, one degree of freedom is left.

    Args:
        covariance: V, (p, p). slopes: its derivatives by the logarithms of the scales, (k, p, p).
        uncertainty: covariance of those logarithms, (k, k). most: the largest number of degrees of freedom.
    """
    values, axes = np.linalg.eigh(covariance)
    along = np.einsum("pi,kpq,qi->ki", axes, slopes, axes, optimize=True)
    each = satterthwaite(values, along, uncertainty, most)
    each = each[each > 2]
    mean, count = float((each / (each - 2)).sum()), len(values)
    return min(2 * mean / (mean - count), most) if mean > count else 1.0
