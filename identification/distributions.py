"""Tails and quantiles of the usual distributions.

They are those of `scipy.stats` to the last bit. Loading that takes a third of a second; what few commands
need of it is imported where it is used.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, chdtri, fdtrc, fdtri, gammaincinv, log_ndtr, ndtr, ndtri, stdtr, stdtrit


def normal_sf(z: ArrayLike) -> np.ndarray:
    """Return the probability of more than z."""
    return ndtr(-np.asarray(z))


def normal_isf(p: float) -> float:
    """Return what is exceeded with probability p."""
    return -float(ndtri(p))


def normal_logcdf(z: ArrayLike) -> np.ndarray:
    """Return ln of the probability of at most z."""
    return log_ndtr(np.asarray(z))


def t_sf(t: ArrayLike, dof: ArrayLike) -> np.ndarray:
    """Return the probability of more than t by Student's distribution."""
    return stdtr(dof, -np.asarray(t))


def t_ppf(p: ArrayLike, dof: ArrayLike) -> np.ndarray:
    """Return what is not exceeded with probability p by Student's distribution."""
    return stdtrit(dof, p)


def chi2_sf(square: ArrayLike, dof: ArrayLike) -> np.ndarray:
    """Return the probability of more than `square`; NaN without a degree of freedom."""
    return np.where(np.asarray(dof) > 0, chdtrc(dof, np.maximum(square, 0.0)), np.nan)


def chi2_isf(p: ArrayLike, dof: ArrayLike) -> np.ndarray:
    """Return what is exceeded with probability p."""
    return chdtri(dof, p)


def chi2_ppf(p: ArrayLike, dof: ArrayLike) -> np.ndarray:
    """Return what is not exceeded with probability p."""
    return 2 * gammaincinv(np.asarray(dof) / 2, p)


def f_sf(ratio: ArrayLike, above: ArrayLike, below: ArrayLike) -> np.ndarray:
    """Return the probability of more than `ratio` by Fisher's; NaN without degrees of freedom."""
    some = (np.asarray(above) > 0) & (np.asarray(below) > 0)
    return np.where(some, fdtrc(above, below, np.maximum(ratio, 0.0)), np.nan)


def f_ppf(p: ArrayLike, above: ArrayLike, below: ArrayLike) -> np.ndarray:
    """Return what is not exceeded with probability p by Fisher's distribution."""
    return fdtri(above, below, p)
