"""Restricted likelihood of base parameters, families of members and scales of the noise.

y = N nu + sum_f G_f phi_f + e,  phi_f ~ N(0, tau_f^2 C_f),  V_0 = cov(e) = F + sum_k sigma_k^2 K_k.

`noise_structure` holds V_0; the families add a low rank to it: V = V_0 + G D G'. The spreads tau and the
scales sigma minimise

    1/2 (ln|V| + ln|N' V^-1 N| + y' P y) - ln prior,   P = V^-1 - V^-1 N (N' V^-1 N)^-1 N' V^-1

(Patterson and Thompson 1971). With B = G' P_0 G and b = G' P_0 y of V_0 alone, D = R R' and
S = (I + R'BR)^-1, it is that of V_0 plus 1/2 (-ln|S| - b' R S R' b), which holds at tau = 0 too. All scales
are estimated by their logarithms. ln tau has the prior of a half-Cauchy tau (Gelman 2006): a family that no
reading shows has its mode at tau = 1, and one that the readings do not want becomes small, but never zero.
One member says next to nothing of the spread of its family: there ln tau is normal about zero, with a factor
of two as s.d. ln sigma is normal about the data sheet. In the scales of the noise Newton's steps use the
average information (Gilmour, Thompson and Cullis 1995), in the spreads the Hessian itself. The covariance of
the estimates holds the uncertainty of the scales to first order (Kass and Steffey 1989). Where columns G hold
noise, G' V_0^-1 G is corrected for it (Nakamura 1990).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tulip_testbed.identification.estimators.errors_in_variables import MOST_CORRECTION
from tulip_testbed.identification.noise_structure import NoiseStructure, Weights

MOST_STEP = 1.5  # of the logarithm of a scale
LIMIT = 7.0  # largest size of the logarithm of a scale
QUIETEST = np.log(0.05)  # of a scale of the noise: less leaves residuals without any
# Of a spread, in tolerances. Beyond, columns are no longer linear in the members: gains of -100 % leave no
# reading, and so no noise.
WIDEST = np.log(20.0)
MOST_STEPS = 60
HALVINGS = 5  # of a step that does not gain
ALONE = np.log(2.0)  # s.d. of ln tau of a family of one
CONVERGED = 1e-3  # of the log-likelihood: a step of less than a twentieth of a standard deviation
SETTLED = 1e-6  # of the log-likelihood, in the spreads alone
ROUNDING = 1e-14  # of the largest information, that is lost where columns N are projected out
LEAST_CURVATURE = 0.25  # the s.d. of the logarithm of a scale is at most two


@dataclass(frozen=True)
class Problem:
    """A linear model of r residuals of each of m postures.

    Attributes:
        whole: N, G and y side by side, (m, r, p + q + 1); zero in rows that are not in use.
        flat: p, the number of columns of N.
        noise: V_0, of k scales.
        information: of nu, known beforehand with mean zero, (p, p).
        roots: square root of C_f by family, (n_f, n_f) each; together q rows.
        doubt: s.d. of ln sigma about zero, (k,).
        excess: what the noise in the columns adds to G' V_0^-1 G on average, (q, q).
        about: members at which y was linearised, (q,); there the noise of the columns has no effect.
        known: numbers of the families whose spread is known, tau = 1.
    """

    whole: np.ndarray
    flat: int
    noise: NoiseStructure
    information: np.ndarray
    roots: tuple[np.ndarray, ...]
    doubt: np.ndarray
    excess: np.ndarray
    about: np.ndarray
    known: tuple[int, ...] = ()

    @property
    def columns(self) -> np.ndarray:
        """Return N, (m, r, p)."""
        return self.whole[..., : self.flat]

    @property
    def members(self) -> np.ndarray:
        """Return G, (m, r, q)."""
        return self.whole[..., self.flat : -1]

    @property
    def output(self) -> np.ndarray:
        """Return y, (m, r)."""
        return self.whole[..., -1]

    @property
    def parts(self) -> list[slice]:
        """Return the columns of G that belong to each family."""
        ends = np.cumsum([0, *map(len, self.roots)]).tolist()
        return [slice(a, b) for a, b in pairwise(ends)]


@dataclass(frozen=True)
class Fit:
    """The estimate at the mode of the scales.

    Attributes:
        scales, spreads: sigma, (k,), and tau, (f,).
        scale_covariance: covariance of ln sigma and ln tau, (k + f, k + f).
        estimate: nu and phi, (p + q,).
        conditional: their covariance if the scales were known, (p + q, p + q).
        covariance: their covariance, (p + q, p + q).
        value: minus the logarithm of the restricted likelihood and of the priors, up to a constant that
            depends on the number of rows and columns N alone.
        log_evidence: ln of the likelihood that is left when all unknowns and scales are integrated out, up
            to the same constant (Laplace's approximation at the mode of the scales).
    """

    scales: np.ndarray
    spreads: np.ndarray
    scale_covariance: np.ndarray
    estimate: np.ndarray
    conditional: np.ndarray
    covariance: np.ndarray
    value: float
    log_evidence: float


@dataclass(frozen=True)
class _Noise:
    """What depends on ln sigma alone: V_0^-1, its products with [N G y], and the likelihood of V_0."""

    log_scale: np.ndarray
    weights: Weights
    weighted: np.ndarray
    gram: np.ndarray
    flat: np.ndarray
    reduced: np.ndarray
    moment: np.ndarray
    square: float
    value: float


@dataclass(frozen=True)
class _Spread:
    """What ln tau adds: value, gradient and Hessian of the objective; R, S and u with phi = R u.

    `square` is what the members take from the residuals' sum of squares.
    """

    log_spread: np.ndarray
    square: float
    value: float
    gradient: np.ndarray
    hessian: np.ndarray
    root: np.ndarray
    shrinkage: np.ndarray
    deviate: np.ndarray


def fit(problem: Problem, start: tuple[np.ndarray, np.ndarray] | None = None) -> Fit:
    """Estimate scales, spreads, base parameters and members.

    Args:
        start: sigma and tau from which the search begins; ones if None.

    Raises:
        numpy.linalg.LinAlgError: readings that are not finite, or columns N that are not independent.
    """
    k, f = len(problem.noise), len(problem.roots)
    first = (np.zeros(k), np.zeros(f)) if start is None else (np.log(start[0]), np.log(start[1]))
    noise = _noise(problem, first[0])
    spread = _spreads(problem, noise, first[1])
    for _ in range(MOST_STEPS):
        gradient, hessian, _ = _joint(problem, noise, spread)
        step = _step(gradient, hessian)
        if abs(gradient @ step) < CONVERGED:
            break
        for shrink in 0.5 ** np.arange(HALVINGS):
            trial = _noise(problem, np.clip(noise.log_scale + shrink * step[:k], QUIETEST, LIMIT))
            found = _spreads(problem, trial, np.clip(spread.log_spread + shrink * step[k:], -LIMIT, WIDEST))
            gained = noise.value + spread.value - trial.value - found.value
            if gained >= 0:
                break
        else:
            break
        noise, spread = trial, found
        if gained < CONVERGED:
            break
    return _result(problem, noise, spread)


def given(problem: Problem, scales: np.ndarray, spreads: np.ndarray) -> Fit:
    """Return the estimate with known scales (k,) and spreads (f,)."""
    noise = _noise(problem, np.log(scales))
    found = _result(problem, noise, _spread(problem, noise, np.log(spreads)))
    return replace(found, scale_covariance=0 * found.scale_covariance, covariance=found.conditional)


def objective(problem: Problem, log_scale: np.ndarray, log_spread: np.ndarray) -> tuple[float, np.ndarray]:
    """Return minus the logarithm of the restricted likelihood and the priors, and its gradient, (k + f,).

    Constants are left out.
    """
    noise = _noise(problem, log_scale)
    spread = _spread(problem, noise, log_spread)
    return noise.value + spread.value, _joint(problem, noise, spread)[0]


def parts_of_variance(problem: Problem, found: Fit) -> np.ndarray:
    """Return the parts of the conditional covariance of nu, (2 + k + f, p, p).

    They are due to known information, fixed noise, each sigma_k and each tau_f. Without `excess` their sum is
    that covariance.
    """
    noise, p = _noise(problem, np.log(found.scales)), problem.flat
    across, width = noise.weighted[..., :-1], len(found.conditional)
    flat = across.reshape(-1, width)
    # Z' V_0^-1 K_k V_0^-1 Z times sigma_k^2.
    spreads = [flat.T @ pushed.reshape(-1, width) for pushed in noise.weights.parts(across)]
    of_nu, information = found.conditional[:p], np.zeros((width, width))
    information[:p, :p] = problem.information
    fixed = flat.T @ (problem.noise.fixed @ across).reshape(-1, width)
    parts = [of_nu @ middle @ of_nu.T for middle in (information, fixed, *spreads)]
    for part, one, size in zip(problem.parts, problem.roots, found.spreads, strict=True):
        half = np.linalg.solve(size * one, found.conditional[p:, :p][part])
        parts.append(half.T @ half)
    return np.array(parts)


def _noise(problem: Problem, log_scale: np.ndarray) -> _Noise:
    weights = problem.noise.weights(log_scale)
    weighted = weights(problem.whole)
    width = weighted.shape[2]
    gram = problem.whole.reshape(-1, width).T @ weighted.reshape(-1, width)
    p = problem.flat
    information = gram[:p, :p] + problem.information
    size = 1 / np.sqrt(np.diag(information))
    root = np.linalg.cholesky(size[:, None] * information * size)
    half = np.linalg.solve(root, size[:, None] * gram[:p, p:])
    rest = gram[p:, p:] - half.T @ half
    if problem.excess.any():
        least = np.exp(-2 * WIDEST) * np.eye(len(rest) - 1)  # of the prior at the largest spread
        bounded = _bounded(problem.excess, rest[:-1, :-1] + least)
        noisy = np.column_stack([np.eye(len(rest) - 1), problem.about])
        gram[p:, p:] -= noisy.T @ bounded @ noisy
        rest = rest - noisy.T @ bounded @ noisy
    inverse_root = np.linalg.inv(root) * size
    flat = inverse_root.T @ inverse_root
    logs = weights.log_volume + np.log(np.diag(root) / size).sum()
    prior = 0.5 * ((log_scale / problem.doubt) ** 2).sum()
    return _Noise(
        log_scale=log_scale,
        weights=weights,
        weighted=weighted,
        gram=gram,
        flat=flat,
        reduced=_without_negative(rest[:-1, :-1]),
        moment=rest[:-1, -1],
        square=float(rest[-1, -1]),
        value=float(logs + 0.5 * rest[-1, -1] + prior),
    )


def _without_negative(information: np.ndarray) -> np.ndarray:
    """Return a matrix of information without the negative parts that rounding gave it."""
    values, axes = np.linalg.eigh(information)
    if not len(values) or values[0] >= 0:
        return information
    return (axes * np.maximum(values, 0.0)) @ axes.T


def _bounded(excess: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Return the excess, in every direction at most half of the information (Fuller 1987, ch. 2.5)."""
    values, axes = np.linalg.eigh(information)
    size = np.sqrt(np.maximum(values, ROUNDING * values[-1]))
    half = axes / size
    share, turn = np.linalg.eigh(half.T @ excess @ half)
    back = (axes * size) @ turn
    return (back * np.minimum(share, MOST_CORRECTION)) @ back.T


def _spread(problem: Problem, noise: _Noise, log_spread: np.ndarray) -> _Spread:
    parts, q = problem.parts, len(noise.moment)
    root = np.zeros((q, q))
    for part, one, size in zip(parts, problem.roots, np.exp(log_spread), strict=True):
        root[part, part] = size * one
    lower = np.linalg.cholesky(np.eye(q) + root.T @ noise.reduced @ root)
    inverse = np.linalg.inv(lower)
    shrinkage = inverse.T @ inverse
    pull = root.T @ noise.moment
    deviate = shrinkage @ pull
    first = np.array([part.start for part in parts], int)
    own, sizes = (
        np.add.reduceat(values, first) if q else np.zeros(0) for values in (np.diag(shrinkage), deviate**2)
    )
    count = np.array([len(one) for one in problem.roots])
    prior, slope, curvature = _log_prior(log_spread, count)
    known = list(problem.known)
    together = 2 * shrinkage**2 + 4 * deviate[:, None] * shrinkage * deviate
    hessian = np.diag(2 * (own + sizes) + curvature)
    if q:
        hessian -= np.add.reduceat(np.add.reduceat(together, first, axis=0), first, axis=1)
    gradient = count - own - sizes + slope
    gradient[known] = 0.0
    hessian[known] = hessian[:, known] = 0.0
    hessian[known, known] = 1.0
    return _Spread(
        log_spread=log_spread,
        square=float(pull @ deviate),
        value=float(np.log(np.diag(lower)).sum() - 0.5 * pull @ deviate + np.delete(prior, known).sum()),
        gradient=gradient,
        hessian=hessian,
        root=root,
        shrinkage=shrinkage,
        deviate=deviate,
    )


def _log_prior(log_spread: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return minus the logarithm of the prior of ln tau, and its first and second derivatives.

    Args:
        count: number of members of each family.
    """
    alone = count == 1
    odds = np.exp(2 * log_spread) / (1 + np.exp(2 * log_spread))
    value = np.where(
        alone,
        0.5 * (log_spread / ALONE) ** 2 + np.log(ALONE * np.sqrt(2 * np.pi)),
        np.log1p(np.exp(2 * log_spread)) - log_spread + np.log(np.pi / 2),
    )
    slope = np.where(alone, log_spread / ALONE**2, 2 * odds - 1)
    return value, slope, np.where(alone, ALONE**-2.0, 4 * odds * (1 - odds))


def _spreads(problem: Problem, noise: _Noise, start: np.ndarray) -> _Spread:
    """Minimise over ln tau with the noise as it is."""
    best = _spread(problem, noise, start)
    for _ in range(MOST_STEPS):
        step = _step(best.gradient, best.hessian)
        if abs(best.gradient @ step) < SETTLED:
            break
        for shrink in 0.5 ** np.arange(HALVINGS):
            trial = _spread(problem, noise, np.clip(best.log_spread + shrink * step, -LIMIT, WIDEST))
            if trial.value <= best.value:
                break
        else:
            break
        best = trial
    return best


def _step(gradient: np.ndarray, hessian: np.ndarray) -> np.ndarray:
    """Return Newton's step with positive curvatures, at most MOST_STEP in every direction."""
    values, turn = np.linalg.eigh(hessian)
    along = -(turn.T @ gradient) / np.maximum(np.abs(values), LEAST_CURVATURE)
    return np.clip(turn @ along, -MOST_STEP, MOST_STEP)


def _posterior(problem: Problem, noise: _Noise, spread: _Spread) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of nu and phi with the scales known, (p + q,) and (p + q, p + q)."""
    p = problem.flat
    members = spread.root @ spread.shrinkage @ spread.root.T
    carry = noise.flat @ noise.gram[:p, p:-1]
    cross = -carry @ members
    covariance = np.block([[noise.flat - cross @ carry.T, cross], [cross.T, members]])
    phi = spread.root @ spread.deviate
    nu = noise.flat @ (noise.gram[:p, -1] - noise.gram[:p, p:-1] @ phi)
    return np.concatenate([nu, phi]), covariance


def _joint(
    problem: Problem, noise: _Noise, spread: _Spread
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]:
    """Return gradient and Hessian in ln sigma and ln tau, and what the covariance needs too.

    Returns:
        gradient, (k + f,); Hessian, (k + f, k + f); estimate; conditional covariance; d estimate / d ln
        scales, (p + q, k + f).
    """
    k, p = len(problem.noise), problem.flat
    estimate, covariance = _posterior(problem, noise, spread)
    weighted = noise.weighted @ np.append(-estimate, 1.0)
    across = noise.weighted[..., :-1]
    width = across.shape[2]
    pushed = np.concatenate(
        [np.zeros((*weighted.shape, 0)), *noise.weights.parts(weighted[..., None])], axis=2
    )
    score = noise.weights.traces(across, covariance) - np.tensordot(weighted, pushed, axes=2)
    score += noise.log_scale / problem.doubt**2
    phi = estimate[p:]
    each = np.zeros((len(phi), len(problem.roots)))
    for j, part in enumerate(problem.parts):
        each[part, j] = phi[part]
    pushed = np.concatenate([pushed, problem.members @ each], axis=2)
    solved = noise.weights(pushed).reshape(-1, pushed.shape[2])
    q = pushed.reshape(-1, pushed.shape[2])
    on_columns = across.reshape(-1, width).T @ q
    hessian = 2 * (q.T @ solved - on_columns.T @ covariance @ on_columns)
    hessian[:k, :k] += np.diag(problem.doubt**-2.0)
    known = [k + number for number in problem.known]
    hessian[known] = hessian[:, known] = 0.0
    hessian[k:, k:] = spread.hessian
    slope = np.empty((width, k + each.shape[1]))
    slope[:, :k] = -2 * covariance @ on_columns[:, :k]
    for j, part in enumerate(problem.parts):
        u = np.zeros(len(phi))
        u[part] = spread.deviate[part]
        slope[p:, k + j] = 2 * spread.root @ (spread.shrinkage @ u)
    slope[:, known] = 0.0
    slope[:p, k:] = -noise.flat @ noise.gram[:p, p:-1] @ slope[p:, k:]
    return (
        np.concatenate([score, spread.gradient]),
        hessian,
        (estimate, covariance, slope),
    )


def _result(problem: Problem, noise: _Noise, spread: _Spread) -> Fit:
    _, hessian, (estimate, conditional, slope) = _joint(problem, noise, spread)
    values, turn = np.linalg.eigh(hessian)
    doubt = (turn / np.maximum(values, LEAST_CURVATURE)) @ turn.T
    # The sum of squares by the residuals themselves: far from where the columns hold, the difference of two
    # large numbers is none, and the correction for their noise promises a better fit than a perfect one.
    left = problem.whole @ np.append(-estimate, 1.0)
    nu = estimate[: problem.flat]
    square = np.vdot(left, noise.weights(left[..., None])[..., 0]) + nu @ problem.information @ nu
    square += spread.deviate @ spread.deviate
    value = float(noise.value + spread.value + 0.5 * (square - (noise.square - spread.square)))
    # A known spread has the curvature 1 and is not integrated over.
    volume = 0.5 * np.log(2 * np.pi / np.maximum(values, LEAST_CURVATURE)).sum()
    volume -= 0.5 * np.log(2 * np.pi) * len(problem.known)
    return Fit(
        scales=np.exp(noise.log_scale),
        spreads=np.exp(spread.log_spread),
        scale_covariance=doubt,
        estimate=estimate,
        conditional=conditional,
        covariance=conditional + slope @ doubt @ slope.T,
        value=value,
        log_evidence=float(volume - value),
    )
