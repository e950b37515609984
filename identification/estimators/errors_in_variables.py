"""Least squares corrected for the encoders' errors in the regressor, and for no other errors."""

from dataclasses import replace

import numpy as np

from tulip_testbed.identification.estimators.estimate import Estimate
from tulip_testbed.identification.estimators.ordinary import estimate_at, least_squares, solve
from tulip_testbed.identification.regressor import Regression

MOST_CORRECTION = 0.5  # of the information in any direction


def bounded_excess(excess: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Return the part of H'H due to encoder errors, bounded by half of it in any direction.

    A larger part cannot be distinguished from chance and would make the corrected equations nearly singular
    (Fuller 1987, ch. 2.5, bounds it for the same reason).
    """
    half = np.linalg.inv(np.linalg.cholesky(information))
    share = float(np.linalg.eigvalsh(half @ excess @ half.T)[-1])
    return excess * min(1.0, MOST_CORRECTION / max(share, 1e-300))


def corrected_least_squares(data: Regression) -> Estimate:
    """Compute theta = (H'H - D)^-1 H'y, D = s^2 sum_j (dH/dq_j)' (dH/dq_j) (Fuller 1987, ch. 3.1).

    Where y depends on the angles too, s^2 sum_j (dH/dq_j)' (-dy/dq_j) is added to H'y.

    Its covariance is sigma^2 A H'H A with A = (H'H - D)^-1 for independent errors of the postures.
    """
    if data.slope is None or not data.encoder_sd:
        return least_squares(data)
    start, _ = solve(data)
    orthogonal, triangle = np.linalg.qr(data.matrix)
    back = np.linalg.inv(triangle)
    blurred = data.encoder_sd * data.slope.reshape(-1, len(start)) @ back
    known = 0.0 if data.known_slope is None else data.encoder_sd * blurred.T @ data.known_slope.ravel()
    identity = np.eye(len(start))
    corrected = np.linalg.inv(identity - bounded_excess(blurred.T @ blurred, identity))
    value = back @ corrected @ (orthogonal.T @ data.output + known)
    found = estimate_at(data, value, back @ corrected @ back.T)
    return replace(found, covariance=found.sigma**2 * back @ corrected @ corrected @ back.T)
