"""Ordinary least squares on the centre of pressure (eq. 8)."""

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from tulip_testbed.identification.estimators.estimate import Estimate
from tulip_testbed.identification.rank import labels, require_identifiable
from tulip_testbed.identification.regressor import Regression
from tulip_testbed.identification.variance_components import fit_components
from tulip_testbed.measurements import SensorSheet


def solve_least_squares(matrix: np.ndarray, output: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return theta minimising |H theta - y| (eq. 8) and C = (H'H)^-1, by QR without forming H'H."""
    require_identifiable(matrix, tuple(str(k + 1) for k in range(matrix.shape[1])), "regressor")
    return by_qr(matrix, output)


def by_qr(matrix: np.ndarray, output: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return theta and C as `solve_least_squares`, without checking the rank."""
    scale = np.linalg.norm(matrix, axis=0)
    orthogonal, triangle = np.linalg.qr(matrix / scale)
    inverse = solve_triangular(triangle, np.eye(len(scale))) / scale[:, None]
    return solve_triangular(triangle, orthogonal.T @ output) / scale, inverse @ inverse.T


def solve(data: Regression) -> tuple[np.ndarray, np.ndarray]:
    """Return theta (eq. 8) and C = (H'H)^-1 after checking that the postures determine all parameters."""
    require_identifiable(data.matrix, labels(data.numbers, data.names), data.source, data.blur)
    return by_qr(data.matrix, data.output)


def residual_sigma(data: Regression, value: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Return the residual e = y - H theta (eq. 12), sigma (eq. 14) and the degrees of freedom r - p."""
    residual = data.output - data.matrix @ value
    dof = len(residual) - len(value)
    return residual, float(np.sqrt(residual @ residual / dof)), dof


def least_squares(data: Regression) -> Estimate:
    """Estimate by ordinary least squares, with eq. 14's and placement-clustered standard errors."""
    return estimate_at(data, *solve(data))


def estimate_at(data: Regression, value: np.ndarray, c: np.ndarray) -> Estimate:
    """Return an estimate with the errors of least squares.

    Args:
        value: the parameters, (p,). c: (H'H)^-1 or what takes its place, (p, p).
    """
    residual, sigma, dof = residual_sigma(data, value)
    clustered, placement_sd = clustered_covariance(data, c)
    return Estimate(
        numbers=data.numbers,
        names=data.names,
        value=value,
        covariance=sigma**2 * c,
        clustered_covariance=clustered,
        residual=residual,
        sigma=sigma,
        placement_sd=placement_sd,
        dof=dof,
        interval_dof=np.full(len(value), float(dof)),
        joint_dof=float(dof),
        condition_number=float(np.linalg.cond(data.matrix)),
    )


def clustered_covariance(data: Regression, c: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Return the covariance of eq. 8's estimate if postures of a placement share errors.

    An error of a recorded plate pose displaces the centre of pressure by the load share on that plate times
    the error, in all postures of the placement; eq. 14 assumes independent errors. Here the errors are
    e = Z_r u_r + Z_l u_l + w with variances by restricted maximum likelihood (`variance_components`), without
    any data sheet, and least squares has the covariance C H' V H C.

    Args:
        c: (H'H)^-1, (p, p).

    Returns:
        Covariance, (p, p) [m2], and the s.d. of the right and left plate's placement errors [m].
    """
    fit = fit_components(replace(data, cells=None, levers=None, sensors=SensorSheet()), None)
    rows = data.matrix[fit.rows] * (fit.rows >= 0)[..., None]
    spread = np.tensordot(rows, np.linalg.solve(fit.inverse, rows), axes=((0, 1), (0, 1)))
    return c @ spread @ c, fit.placement_sd
