"""Least squares on the centre of pressure (eq. 8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from identification.placement_effects import clustered_covariance
from identification.rank import labels, require_told_apart
from identification.regressor import Regression


@dataclass(frozen=True)
class Estimate:
    """An estimate and what its own residuals say of its errors.

    Attributes:
        numbers, names: of the parameters, (p,).
        value: (p,) [m].
        covariance: sigma^2 C, C = (H'H)^-1, for independent errors (eqs 13, 14), (p, p) [m2].
        clustered_covariance: with errors common to a placement allowed for, (p, p) [m2].
        residual: e = y - H theta (eq. 12), (2m,) [m].
        sigma: eq. 14 [m].
        placement_sd: estimated s.d. per axis of the placement errors of the right and left plate [m].
        dof: r - p.
        condition_number: of H.
    """

    numbers: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    clustered_covariance: np.ndarray
    residual: np.ndarray
    sigma: float
    placement_sd: tuple[float, float]
    dof: int
    condition_number: float


def solve_least_squares(matrix: np.ndarray, output: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """theta minimising |H theta - y| (eq. 8) and C = (H'H)^-1, by QR and never by H'H itself.

    Raises:
        InputError: H has not full column rank; says which columns (from 1) cannot be told apart.
    """
    require_told_apart(matrix, tuple(str(k + 1) for k in range(matrix.shape[1])), "regressor")
    scale = np.linalg.norm(matrix, axis=0)
    orthogonal, triangle = np.linalg.qr(matrix / scale)
    inverse = solve_triangular(triangle, np.eye(len(scale))) / scale[:, None]
    return solve_triangular(triangle, orthogonal.T @ output) / scale, inverse @ inverse.T


def least_squares(data: Regression) -> Estimate:
    """Ordinary least squares with eq. 14's and placement-clustered standard errors.

    Raises:
        InputError: postures that cannot tell all parameters apart; says which.
    """
    require_told_apart(data.matrix, labels(data.numbers, data.names), data.source, data.blur)
    value, c = solve_least_squares(data.matrix, data.output)
    residual = data.output - data.matrix @ value
    dof = len(residual) - len(value)
    sigma2 = residual @ residual / dof
    clustered, placement_sd = clustered_covariance(data, c)
    return Estimate(
        numbers=data.numbers,
        names=data.names,
        value=value,
        covariance=sigma2 * c,
        clustered_covariance=clustered,
        residual=residual,
        sigma=float(np.sqrt(sigma2)),
        placement_sd=placement_sd,
        dof=dof,
        condition_number=float(np.linalg.cond(data.matrix)),
    )
