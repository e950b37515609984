"""Least squares on the centre of pressure (eq. 8), ordinary and with less weight for outlying postures."""

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from tulip_testbed.identification.estimators.estimate import Estimate
from tulip_testbed.identification.rank import labels, require_identifiable
from tulip_testbed.identification.regressor import Regression
from tulip_testbed.identification.variance_components import fit_components
from tulip_testbed.measurements import SensorSheet

EXACT = 1e-12  # of the output's size; smaller residuals need no weights


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
    """Return the estimate at a value, (p,), with the errors of least squares of (H'H)^-1 or its like, c."""
    _, sigma, dof = residual_sigma(data, value)
    clustered, placement_sd = clustered_covariance(data, c)
    freedom = np.full(len(value), float(dof)), float(dof)
    return estimate_with(data, value, sigma**2 * c, clustered, placement_sd, freedom)


def estimate_with(
    data: Regression,
    value: np.ndarray,
    covariance: np.ndarray,
    clustered: np.ndarray,
    placement_sd: tuple[float, float],
    freedom: tuple[np.ndarray, float],
) -> Estimate:
    """Return an estimate, (p,) [m], with these errors and degrees of freedom of each and of all."""
    residual, sigma, dof = residual_sigma(data, value)
    return Estimate(
        numbers=data.numbers,
        names=data.names,
        value=value,
        covariance=covariance,
        clustered_covariance=clustered,
        residual=residual,
        sigma=sigma,
        placement_sd=placement_sd,
        dof=dof,
        interval_dof=freedom[0],
        joint_dof=freedom[1],
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


def huber(data: Regression) -> Estimate:
    """Estimate by Huber's M-estimator (1964) with 95 % efficiency, scaled by the median absolute deviation.

    Its covariance is Huber's (1973): C times sigma^2 of the clipped residuals over their mean slope. This
    equals least squares on the pseudo-observations H theta + clipped residuals over the mean slope, whose
    solution is the M-estimate itself; so the clustered covariance follows as for least squares.
    """
    start, _ = solve(data)
    if residual_sigma(data, start)[1] <= EXACT * np.abs(data.output).max(initial=0.0):
        return least_squares(data)
    import statsmodels.api as sm  # takes a second to import

    fitted = sm.RLM(data.output, data.matrix, M=sm.robust.norms.HuberT()).fit(tol=1e-10, maxiter=200)
    ratio = (data.output - data.matrix @ fitted.params) / fitted.scale
    norm = sm.robust.norms.HuberT()
    clipped = fitted.scale * norm.psi(ratio) / norm.psi_deriv(ratio).mean()
    pseudo = least_squares(replace(data, output=data.matrix @ fitted.params + clipped))
    residual, sigma, _ = residual_sigma(data, pseudo.value)
    return replace(pseudo, residual=residual, sigma=sigma)
