"""Variance components of the centre of pressure by restricted maximum likelihood.

y = H theta + cells + right plate + left plate + encoders. The s.d. of the first three errors are
s_k = exp(tau_k) times those of the data sheet; that of the encoders is known (`loop_closure`).
V = E + sum_k exp(2 tau_k) K_k has one block per placement. tau maximises the restricted likelihood
(Patterson and Thompson 1971) times a log-normal prior about the data sheet with a factor of two as s.d.;
Newton's steps use the average information (Gilmour, Thompson and Cullis 1995).
"""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.regressor import Regression

SHEET_PRIOR = np.log(2.0)  # s.d. of ln s_k if a data sheet states s_k
NO_PRIOR = np.log(100.0)  # if it does not; the prior is then centred at the size of the residuals
MARK_RATIO = 0.5  # s.d. of the right plate over that of the left, with a factor of four as s.d.
MARK_PRIOR = np.log(4.0)
YAW_RATIO = 3.0  # rad/m: s.d. of a recorded yaw over that of a position, assumed without a data sheet
MOST_TAU = 12.0
MOST_STEP = 2.0
MOST_STEPS = 50
CONVERGED = 1e-8  # of the log-likelihood


@dataclass(frozen=True)
class Components:
    """A fitted covariance V and the quantities that generalised least squares needs.

    Attributes:
        inverse: V^-1 by placement, padded, (g, r, r) [1/m2].
        rows: rows of H of each placement, padded with -1, (g, r).
        triangle: R of H = Q R, (p, p).
        information: Q' V^-1 Q, (p, p).
        gain: Q' V^-1 e with e the residual of least squares, (p,).
        scale: fitted factors on the stated s.d. of cells, right plate and left plate, (3,).
        placement_sd: fitted s.d. of the positions of the right and the left plate [m].
        covariance: covariance of ln scale, (3, 3).
        slopes: d(Q' V^-1 Q)/d(ln scale), (3, p, p).
    """

    inverse: np.ndarray
    rows: np.ndarray
    triangle: np.ndarray
    information: np.ndarray
    gain: np.ndarray
    scale: np.ndarray
    placement_sd: tuple[float, float]
    covariance: np.ndarray
    slopes: np.ndarray


def fit_components(data: Regression, encoders: np.ndarray | None) -> Components:
    """Fit the variance components.

    Args:
        data: the regression; encoders: covariance of each posture's encoder errors, (m, 2, 2) [m2], or None.
    """
    count = len(data.placement)
    basis, triangle = np.linalg.qr(data.matrix)
    residual = data.output - basis @ (basis.T @ data.output)
    rows = _rows(data.placement)
    inside = rows >= 0
    whole = np.column_stack([basis, residual])[rows] * inside[..., None]
    postures, pairs = rows[:, ::2] // 2, np.arange(0, rows.shape[1], 2)

    def diagonal(blocks: np.ndarray) -> np.ndarray:
        """Spread 2 x 2 blocks of the postures over the blocks of the placements."""
        full = np.zeros((*rows.shape, rows.shape[1]))
        for a in (0, 1):
            for b in (0, 1):
                full[:, pairs + a, pairs + b] = blocks[postures, a, b] * inside[:, ::2]
        return full

    size = _residual_size(data, residual)
    fixed = diagonal(np.zeros((count, 2, 2)) if encoders is None else encoders)
    fixed[:, np.arange(rows.shape[1]), np.arange(rows.shape[1])] += size**2 * ~inside
    cells, plates, position, prior = _stated(data, size)
    levers = (plates * _levers(data)).reshape(2 * count, 2, 3)[rows] * inside[..., None, None]
    kernels = np.stack([diagonal(cells), *(levers[:, :, k] @ levers[:, :, k].mT for k in (0, 1))])

    tau, gained = np.zeros(3), np.inf
    value, gradient, curvature, best = _evaluate(tau, fixed, kernels, whole, prior)
    for _ in range(MOST_STEPS):
        step = np.clip(-np.linalg.solve(curvature, gradient), -MOST_STEP, MOST_STEP)
        if abs(step @ gradient) < CONVERGED or gained < CONVERGED:
            break
        for shrink in 0.5 ** np.arange(20):
            trial = np.clip(tau + shrink * step, -MOST_TAU, MOST_TAU)
            found = _evaluate(trial, fixed, kernels, whole, prior)
            if found[0] <= value:
                break
        else:
            break
        gained, tau = value - found[0], trial
        value, gradient, curvature, best = found
    scale = np.exp(tau)
    right, left = scale[1:] * position
    return Components(
        rows=rows,
        triangle=triangle,
        scale=scale,
        placement_sd=(float(right), float(left)),
        covariance=np.linalg.inv(curvature),
        **best,
    )


def _evaluate(
    tau: np.ndarray, fixed: np.ndarray, kernels: np.ndarray, whole: np.ndarray, prior: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Return minus the log-likelihood, its gradient and average information in tau, with Q instead of H.

    The last are attributes of `Components`.
    """
    part = np.exp(2 * tau)
    scaled = part[:, None, None, None] * kernels
    covariance = fixed + scaled.sum(axis=0)
    log_determinant = 2 * np.log(np.diagonal(np.linalg.cholesky(covariance), axis1=1, axis2=2)).sum()
    inverse = np.linalg.inv(covariance)
    columns = whole.shape[2] - 1
    weighted = inverse @ whole
    gram = np.tensordot(whole, weighted, axes=((0, 1), (0, 1)))
    information, gain = gram[:-1, :-1], gram[:-1, -1]
    root = np.linalg.inv(information)
    coefficients = np.append(-root @ gain, 1.0)
    projected = weighted @ coefficients  # P y, (g, r)
    unexplained = gram[-1] @ coefficients
    log_information = float(np.linalg.slogdet(information)[1])

    pushed = np.einsum("kgab,gb->kga", scaled, projected)
    slopes = np.empty((3, columns, columns))
    score = np.empty(3)
    for k in range(3):
        spread = scaled[k] @ weighted[..., :-1]
        slopes[k] = -2 * np.tensordot(weighted[..., :-1], spread, axes=((0, 1), (0, 1)))
        trace = (inverse * scaled[k]).sum() + 0.5 * (root * slopes[k]).sum()
        score[k] = trace - (projected * pushed[k]).sum()
    back = np.einsum("gab,kgb->kga", inverse, pushed)
    on_basis = np.tensordot(back, whole[..., :-1], axes=((1, 2), (0, 1)))
    curved = 2 * (np.tensordot(pushed, back, axes=((1, 2), (1, 2))) - on_basis @ root @ on_basis.T)
    value = 0.5 * (log_determinant + log_information + unexplained + ((tau / prior) ** 2).sum())
    parts = {"inverse": inverse, "information": information, "gain": gain, "slopes": slopes}
    return value, score + tau / prior**2, curved + np.diag(prior**-2.0), parts


def _rows(placement: np.ndarray) -> np.ndarray:
    """Return the rows of H by placement, padded with -1, (g, r)."""
    _, group, size = np.unique(placement, return_inverse=True, return_counts=True)
    order = np.argsort(group, kind="stable")
    position = np.arange(len(order)) - np.repeat(np.cumsum(size) - size, size)
    table = np.full((len(size), 2 * size.max()), -1)
    table[group[order], 2 * position] = 2 * order
    table[group[order], 2 * position + 1] = 2 * order + 1
    return table


def _residual_size(data: Regression, residual: np.ndarray) -> float:
    """Return the s.d. of the residuals, or rounding errors if larger [m]."""
    dof = max(len(residual) - data.matrix.shape[1], 1)
    least = 1e-12 * (float(np.abs(data.output).max(initial=0.0)) or 1.0)
    return max(float(np.linalg.norm(residual)) / np.sqrt(dof), least)


def _levers(data: Regression) -> np.ndarray:
    """Return the levers of the plate poses, (m, 2, 6), by the load share alone if nothing else is known."""
    if data.levers is not None:
        return data.levers
    levers = np.zeros((len(data.load_share), 2, 6))
    for plate in (0, 1):
        levers[:, 0, 3 * plate] = levers[:, 1, 3 * plate + 1] = data.load_share[:, plate]
    return levers


def _stated(data: Regression, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the start of the search and the s.d. of its prior.

    Returns:
        Covariance of each posture's cells, (m, 2, 2); s.d. of both plates' x, y, yaw, (6,); s.d. of their
        positions, (2,); s.d. of the prior of each tau, (3,).
    """
    shape = np.tile(np.eye(2), (len(data.placement), 1, 1)) if data.cells is None else data.cells
    cell = data.sensors.cell_sd if data.cells is not None else None
    factor = cell or size / np.sqrt(np.trace(shape.mean(axis=0)) / 2)
    prior = [SHEET_PRIOR if cell else NO_PRIOR]
    left = np.array(data.sensors.known_placement_sd)
    if left[:2].any():
        prior += [MARK_PRIOR, SHEET_PRIOR]
        right = MARK_RATIO * left
    else:
        prior += [NO_PRIOR, NO_PRIOR]
        left = right = size * np.array([1.0, 1.0, YAW_RATIO])
    position = np.array([np.hypot(*right[:2]), np.hypot(*left[:2])]) / np.sqrt(2)
    return factor**2 * shape, np.concatenate([right, left]), position, np.array(prior)
