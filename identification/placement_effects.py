"""Errors that a placement's postures share, and what they do to the standard errors.

A plate that does not lie where it was recorded shifts its own reading, so the centre of
pressure moves by the load share on that plate times the error: for both axes, in all postures
of the placement. Eq. 14 takes those for independent. Here
e = Z_r u_r + Z_l u_l + w with variances s_r^2, s_l^2 and sigma^2, estimated by restricted
maximum likelihood (Patterson and Thompson 1971); least squares then has the covariance
C H' V H C.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from identification.regressor import Regression


def clustered_covariance(data: Regression, c: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Covariance of eq. 8's estimate when placements share errors.

    Args:
        data: the regression.
        c: (H'H)^-1, (p, p).

    Returns:
        covariance (p, p) [m2] and the s.d. of the right and left plate's placement errors [m].
    """
    shared = [_shared(data, plate) for plate in (0, 1)]
    contrasts = np.linalg.qr(data.matrix, mode="complete")[0][:, data.matrix.shape[1] :]
    free = contrasts.T @ data.output
    gram = [part @ part.T for part in (contrasts.T @ z for z in shared)]
    size = len(free)

    def deviance(ratio: np.ndarray) -> float:
        factor = cho_factor(np.eye(size) + ratio[0] * gram[0] + ratio[1] * gram[1], lower=True)
        quadratic = free @ cho_solve(factor, free)
        return 2 * np.log(np.diag(factor[0])).sum() + size * np.log(quadratic)

    ratio = np.zeros(2)
    if free @ free > 0:
        starts = ([0.1, 0.1], [0.0, 1.0])
        fits = [minimize(deviance, start, bounds=[(0, 100)] * 2, method="L-BFGS-B") for start in starts]
        ratio = min(fits, key=lambda fit: fit.fun).x
    inner = np.eye(size) + ratio[0] * gram[0] + ratio[1] * gram[1]
    sigma2 = free @ np.linalg.solve(inner, free) / size
    spread = data.matrix.T @ data.matrix
    for weight, z in zip(ratio, shared, strict=True):
        half = data.matrix.T @ z
        spread = spread + weight * half @ half.T
    right, left = (float(np.sqrt(sigma2 * r)) for r in ratio)
    return sigma2 * c @ spread @ c, (right, left)


def _shared(data: Regression, plate: int) -> np.ndarray:
    """Z: which error of which placement reaches which row, (2m, 2 n_placements)."""
    _, index = np.unique(data.placement, return_inverse=True)
    matrix = np.zeros((2 * len(index), 2 * (index.max() + 1)))
    for axis in (0, 1):
        matrix[2 * np.arange(len(index)) + axis, 2 * index + axis] = data.load_share[:, plate]
    return matrix
