"""Degrees of freedom of estimated variances, for t intervals and F tests."""

import numpy as np


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
