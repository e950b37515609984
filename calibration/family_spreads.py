"""Spreads of families in a restricted likelihood, the noise being as it is.

With B the information about the members and b their moment, both without the flat parameters, R the s.d. of
the members and S = (I + R B R)^-1, the families add 1/2 (-ln|S| - b' R S R b) to the objective.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from tulip_testbed.calibration.linear_problem import LinearProblem

MOST_STEP = 1.5  # of the logarithm of a scale
LIMIT = 7.0  # largest size of the logarithm of a scale
# Of a spread, in tolerances. Beyond, columns are no longer linear in the members: gains of -100 % leave no
# reading, and so no noise.
WIDEST = np.log(20.0)
MOST_STEPS = 60
HALVINGS = 5  # of a step that does not gain
FEW = 4  # members that hardly determine the spread of their family
ALONE = np.log(2.0)  # s.d. of ln tau of a family of so few
SETTLED = 1e-6  # of the log-likelihood, in the spreads alone
LEAST_CURVATURE = 0.25  # the s.d. of the logarithm of a scale is at most two

# Of a single matrix NumPy's and SciPy's functions take a multiple of the time.
cholesky_root, inverse_of_root, square_of_root = get_lapack_funcs(("potrf", "trtri", "lauum"))


@dataclass(frozen=True)
class Spread:
    """The terms that ln tau adds: value, gradient and Hessian of the objective; R, (q,), S; u with phi = R u.

    `half` is a lower triangle whose transpose times itself is S. `square` is what the members take from the
    residuals' sum of squares.
    """

    log_spread: np.ndarray
    square: float
    value: float
    gradient: np.ndarray
    hessian: np.ndarray
    root: np.ndarray
    half: np.ndarray
    shrinkage: np.ndarray
    deviate: np.ndarray


def inverted(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the lower root of a positive definite matrix by Cholesky, its inverse and that of the matrix.

    Raises:
        numpy.linalg.LinAlgError: it is not positive definite.
    """
    root, failed = cholesky_root(matrix, lower=True)
    if failed:
        raise np.linalg.LinAlgError("found a matrix that is not positive definite")
    inverse_root, _ = inverse_of_root(root, lower=True)
    half, _ = square_of_root(inverse_root, lower=True)  # its lower half
    return root, inverse_root, half + np.tril(half, -1).T


def at_spread(
    problem: LinearProblem, reduced: np.ndarray, moment: np.ndarray, log_spread: np.ndarray
) -> Spread:
    """Return what the families add at ln tau, (f,).

    Args:
        reduced, moment: B, (q, q), and b, (q,).
    """
    q, count = len(moment), np.array(problem.sizes, int)
    root = np.repeat(np.exp(log_spread), count)
    lower, half, shrinkage = inverted(np.eye(q) + root[:, None] * reduced * root) if q else (reduced,) * 3
    pull = root * moment
    deviate = shrinkage @ pull
    belongs = np.repeat(np.eye(len(count)), count, axis=1)  # families by members
    own, sizes = belongs @ np.diag(shrinkage), belongs @ deviate**2
    prior, slope, curvature = _log_prior(log_spread, count)
    known = list(problem.known)
    together = 2 * shrinkage**2 + 4 * deviate[:, None] * shrinkage * deviate
    hessian = np.diag(2 * (own + sizes) + curvature) - belongs @ together @ belongs.T
    gradient = count - own - sizes + slope
    gradient[known] = 0.0
    hessian[known] = hessian[:, known] = 0.0
    hessian[known, known] = 1.0
    return Spread(
        log_spread=log_spread,
        square=float(pull @ deviate),
        value=float(np.log(np.diag(lower)).sum() - 0.5 * pull @ deviate + np.delete(prior, known).sum()),
        gradient=gradient,
        hessian=hessian,
        root=root,
        half=half,
        shrinkage=shrinkage,
        deviate=deviate,
    )


def _log_prior(log_spread: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return minus the logarithm of the prior of ln tau, and its first and second derivatives.

    Args:
        count: number of members of each family.
    """
    alone = count <= FEW
    odds = np.exp(2 * log_spread) / (1 + np.exp(2 * log_spread))
    value = np.where(
        alone,
        0.5 * (log_spread / ALONE) ** 2 + np.log(ALONE * np.sqrt(2 * np.pi)),
        np.log1p(np.exp(2 * log_spread)) - log_spread + np.log(np.pi / 2),
    )
    slope = np.where(alone, log_spread / ALONE**2, 2 * odds - 1)
    return value, slope, np.where(alone, ALONE**-2.0, 4 * odds * (1 - odds))


def best_spreads(
    problem: LinearProblem, reduced: np.ndarray, moment: np.ndarray, start: np.ndarray
) -> Spread:
    """Minimise over ln tau, beginning at `start`, (f,).

    Args:
        reduced, moment: see `at_spread`.
    """
    best = at_spread(problem, reduced, moment, np.clip(start, -LIMIT, WIDEST))
    for _ in range(MOST_STEPS):
        step = newton_step(best.gradient, best.hessian, best.log_spread, (-LIMIT, WIDEST))
        if abs(best.gradient @ step) < SETTLED:
            break
        for shrink in 0.5 ** np.arange(HALVINGS):
            log_spread = np.clip(best.log_spread + shrink * step, -LIMIT, WIDEST)
            trial = at_spread(problem, reduced, moment, log_spread)
            if trial.value <= best.value:
                break
        else:
            break
        best = trial
    return best


def newton_step(
    gradient: np.ndarray,
    hessian: np.ndarray,
    at: np.ndarray,
    limits: tuple[float | np.ndarray, float | np.ndarray],
) -> np.ndarray:
    """Return Newton's step with positive curvatures, at most MOST_STEP in every direction.

    Logarithms that would leave their limits stay there, and the others move as if these were known (Bertsekas
    1982): cut off afterwards, a step that counts on them does not go down.

    Args:
        at: the logarithms. limits: the lowest and the highest ones.
    """
    held = np.where(gradient > 0, at <= limits[0], at >= limits[1])
    if held.any():
        gradient, hessian = np.where(held, 0.0, gradient), np.where(held | held[:, None], 0.0, hessian)
    values, turn = np.linalg.eigh(hessian)
    along = -(turn.T @ gradient) / np.maximum(np.abs(values), LEAST_CURVATURE)
    return np.where(held, 0.0, np.clip(turn @ along, -MOST_STEP, MOST_STEP))
