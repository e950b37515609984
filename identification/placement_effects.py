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
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from identification.regressor import Regression

# S.d. of placement errors over sigma: where the search starts, and beyond which it does not look.
STARTS = ([0.5, 0.5], [20.0, 20.0])
MOST_RATIO = 1e5


def clustered_covariance(data: Regression, c: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Covariance of eq. 8's estimate when placements share errors.

    Args:
        data: the regression.
        c: (H'H)^-1, (p, p).

    Returns:
        covariance (p, p) [m2] and the s.d. of the right and left plate's placement errors [m].
    """
    shared = [_shared(data, plate) for plate in (0, 1)]
    effects = np.hstack(shared)
    contrasts = np.linalg.qr(data.matrix, mode="complete")[0][:, data.matrix.shape[1] :]
    free = contrasts.T @ data.output
    size = len(free)
    # All that the placement effects can reach lies in a small subspace; outside it V is sigma^2 I.
    basis, reach = np.linalg.qr(contrasts.T @ effects)
    inside = basis.T @ free
    outside = max(free @ free - inside @ inside, 0.0)

    columns = shared[0].shape[1]
    gram = [half @ half.T for half in (reach[:, :columns], reach[:, columns:])]

    def fit(root: np.ndarray) -> tuple[float, float]:
        """ln |V| and e' V^-1 e for sigma = 1."""
        inner = np.eye(len(inside)) + root[0] ** 2 * gram[0] + root[1] ** 2 * gram[1]
        factor = cholesky(inner, lower=True, check_finite=False)
        whitened = np.asarray(solve_triangular(factor, inside, lower=True, check_finite=False))
        return float(2 * np.log(np.diag(factor)).sum()), float(outside + whitened @ whitened)

    def deviance(root: np.ndarray) -> float:
        determinant, quadratic = fit(root)
        return determinant + size * np.log(quadratic)

    root = np.zeros(2)
    if free @ free > 0:
        bounds = [(0.0, MOST_RATIO)] * 2
        fits = [minimize(deviance, start, bounds=bounds, method="L-BFGS-B") for start in STARTS]
        root = min(fits, key=lambda found: found.fun).x
    sigma2 = fit(root)[1] / size
    spread = data.matrix.T @ data.matrix
    for weight, z in zip(root**2, shared, strict=True):
        half = data.matrix.T @ z
        spread = spread + weight * half @ half.T
    right, left = (float(np.sqrt(sigma2) * r) for r in root)
    return sigma2 * c @ spread @ c, (right, left)


def _shared(data: Regression, plate: int) -> np.ndarray:
    """Z: which error of which placement reaches which row, (2m, 2 n_placements)."""
    _, index = np.unique(data.placement, return_inverse=True)
    matrix = np.zeros((2 * len(index), 2 * (index.max() + 1)))
    for axis in (0, 1):
        matrix[2 * np.arange(len(index)) + axis, 2 * index + axis] = data.load_share[:, plate]
    return matrix
