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
from scipy.optimize import minimize

from identification.regressor import Regression

# S.d. of placement errors over sigma: where the search starts, and beyond which it does not look.
STARTS = ([0.5, 0.5], [20.0, 20.0])
MOST_RATIO = 1e5


def clustered_covariance(data: Regression, c: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Covariance of eq. 8's estimate when placements share errors.

    V has a block for every placement and axis, the identity plus two dyads, so its inverse root is
    applied block by block: work and memory grow with the rows, not with their square.

    Args:
        data: the regression.
        c: (H'H)^-1, (p, p).

    Returns:
        covariance (p, p) [m2] and the s.d. of the right and left plate's placement errors [m].
    """
    basis = np.linalg.qr(data.matrix)[0]
    residual = data.output - basis @ (basis.T @ data.output)
    whole = np.column_stack([basis, residual])
    size = len(residual) - basis.shape[1]
    _, placement = np.unique(data.placement, return_inverse=True)
    share = data.load_share
    reached = _sums(placement, share, whole)
    gram = _sums(placement, share, np.repeat(share, 2, axis=0))[:, 0]

    def fit(root: np.ndarray) -> tuple[float, float]:
        """ln |V| + ln |Q' V^-1 Q| and e' V^-1 e for sigma = 1."""
        grown, turn = np.linalg.eigh(root[:, None] * gram * root)
        grown = np.maximum(grown, 0.0)
        # V^-1/2 = 1 + B F B', B = Z diag(root), F by the eigenvalues of B'B; smooth at zero.
        shrink = -1 / (1 + grown + np.sqrt(1 + grown))
        weight = root[:, None] * (turn * shrink[:, None]) @ turn.transpose(0, 2, 1) * root
        change = np.einsum("gij,gajk->gaik", weight, reached)[placement]
        white = whole + np.einsum("mi,maik->mak", share, change).reshape(whole.shape)
        diagonal = np.abs(np.diag(np.linalg.qr(white, mode="r")))
        determinant = 2 * (np.log1p(grown).sum() + np.log(diagonal[:-1]).sum())
        return float(determinant), float(diagonal[-1] ** 2)

    def deviance(root: np.ndarray) -> float:
        determinant, quadratic = fit(root)
        return determinant + size * np.log(quadratic)

    root = np.zeros(2)
    if residual @ residual > 0:
        bounds = [(0.0, MOST_RATIO)] * 2
        fits = [minimize(deviance, start, bounds=bounds, method="L-BFGS-B") for start in STARTS]
        root = min(fits, key=lambda found: found.fun).x
    sigma2 = fit(root)[1] / size
    half = _sums(placement, share, data.matrix)
    spread = data.matrix.T @ data.matrix + np.einsum("gaip,i,gaiq->pq", half, root**2, half, optimize=True)
    right, left = (float(np.sqrt(sigma2) * r) for r in root)
    return sigma2 * c @ spread @ c, (right, left)


def _sums(placement: np.ndarray, share: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Z' times columns (2m, k): sums by placement, axis and plate, (n_placements, 2, 2, k)."""
    terms = share[:, None, :, None] * columns.reshape(len(share), 2, 1, -1)
    sums = np.zeros((placement.max() + 1, *terms.shape[1:]))
    np.add.at(sums, placement, terms)
    return sums
