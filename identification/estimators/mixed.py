"""Generalised least squares with placement effects, without and with the encoders' errors."""

import numpy as np
from scipy.linalg import block_diag

from tulip_testbed.identification.estimators.errors_in_variables import bounded_excess
from tulip_testbed.identification.estimators.estimate import Estimate
from tulip_testbed.identification.estimators.ordinary import estimate_with, solve
from tulip_testbed.identification.regressor import Regression
from tulip_testbed.identification.statistics import of_f_test, satterthwaite
from tulip_testbed.identification.variance_components import Components, fit_components


def placement_effects(data: Regression) -> Estimate:
    """Estimate by generalised least squares with random placement effects and exact encoders."""
    value, _ = solve(data)
    return _estimate(data, value, fit_components(data, None), None)


def mixed_model(data: Regression) -> Estimate:
    """Estimate by generalised least squares with placement effects, corrected for encoder errors.

    Encoder errors add J J' s^2 to a posture's variance, J = (dH/dq) theta, and on average
    D = s^2 sum_ij H_ij' (V^-1)_ii H_ij to H' V^-1 H, which biases the estimate towards zero. The corrected
    score H' V^-1 (y - H theta) + D theta has mean zero (Fuller 1987, ch. 3.1; Nakamura 1990) and variance
    H' V^-1 H. Hence the covariance is A^-1 H' V^-1 H A^-1 with A = H' V^-1 H - D.
    """
    value, _ = solve(data)
    if data.slope is None or not data.encoder_sd:
        return _estimate(data, value, fit_components(data, None), None)
    moved, blurred = data.slope @ value, data.slope
    if data.known_slope is not None:
        moved = moved + data.known_slope
        blurred = np.concatenate([blurred, data.known_slope[..., None]], axis=3)
    moved = data.encoder_sd * moved
    return _estimate(data, value, fit_components(data, moved @ moved.mT), data.encoder_sd * blurred)


def _estimate(data: Regression, start: np.ndarray, fit: Components, blurred: np.ndarray | None) -> Estimate:
    """Refine the estimate of least squares, in coordinates in which the columns of H are orthonormal."""
    information = fit.information
    root = np.linalg.inv(information)
    change = root @ fit.gain
    turned = fit.triangle @ start
    if blurred is not None:
        whole, p = _excess(fit, blurred), len(start)
        excess, known = bounded_excess(whole[:p, :p], information), whole[:p, p:].sum(axis=1)
        corrected = np.linalg.inv(information - excess)
        change = change + corrected @ (excess @ (turned + change) + known)
        root = corrected @ information @ corrected
    back = np.linalg.inv(fit.triangle)
    value = start + back @ change
    covariance = back @ root @ back.T
    freedom = _degrees_of_freedom(fit, back, len(data.output) - len(value))
    return estimate_with(data, value, covariance, covariance, fit.placement_sd, freedom)


def _excess(fit: Components, blurred: np.ndarray) -> np.ndarray:
    """Return D for one s.d. of every encoder times dH/dq, (m, 2, n_joints, p), and perhaps -dy/dq, last."""
    within = fit.rows[:, ::2] >= 0
    pairs = np.arange(0, fit.rows.shape[1], 2)
    blocks = np.empty((len(blurred), 2, 2))
    postures = fit.rows[:, ::2][within] // 2
    for a in (0, 1):
        for b in (0, 1):
            blocks[postures, a, b] = fit.inverse[:, pairs + a, pairs + b][within]
    count, _, joints, columns = blurred.shape
    white = np.linalg.cholesky(blocks).mT @ blurred.reshape(count, 2, joints * columns)
    tall = white.reshape(-1, columns)
    back = np.linalg.inv(fit.triangle)
    back = block_diag(back, np.eye(columns - len(back)))
    return back.T @ (tall.T @ tall) @ back


def _degrees_of_freedom(fit: Components, back: np.ndarray, most: int) -> tuple[np.ndarray, float]:
    """Return those of each parameter's t interval, (p,), and of the F test of all, at most r - p."""
    spread = np.linalg.inv(fit.information) @ back.T
    slopes = -spread.T @ fit.slopes @ spread
    variance = back @ spread
    each = np.diagonal(slopes, axis1=1, axis2=2)
    return (
        satterthwaite(np.diag(variance), each, fit.covariance, most),
        of_f_test(variance, slopes, fit.covariance, most),
    )
