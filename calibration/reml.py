"""Restricted likelihood of base parameters, families of members and scales of the noise.

y = N nu + sum_f G_f phi_f + e,  phi_f ~ N(0, tau_f^2 I),  V_0 = cov(e) = F + sum_k sigma_k^2 K_k.

`noise_structure` holds V_0; the families add a low rank to it: V = V_0 + G D G'. The spreads tau and the
scales sigma minimise

    1/2 (ln|V| + ln|N' V^-1 N| + y' P y) - ln prior,   P = V^-1 - V^-1 N (N' V^-1 N)^-1 N' V^-1

(Patterson and Thompson 1971). With B = G' P_0 G and b = G' P_0 y of V_0 alone, D = R R and S = (I +
R B R)^-1, it is that of V_0 plus 1/2 (-ln|S| - b' R S R b), which holds at tau = 0 too. All scales are
estimated by their logarithms. ln tau has the prior of a half-Cauchy tau (Gelman 2006): a family that no
reading shows has its mode at tau = 1, and one that the readings do not want becomes small, but never zero.
Four members or fewer hardly determine the spread of their family: there ln tau is normal about zero, with a
factor of two as s.d. ln sigma is normal about the data sheet. In the scales of noise that each posture has of
its own, the average information stands for the Hessian (Gilmour, Thompson and Cullis 1995). The covariance of
the estimates holds the uncertainty of the scales to first order (Kass and Steffey 1989). Where columns G
hold noise, G' V_0^-1 G is corrected for it (Nakamura 1990), and the covariance has the noise that it adds.
"""

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.linalg import eigh

from tulip_testbed.calibration.family_spreads import (
    HALVINGS,
    LEAST_CURVATURE,
    LIMIT,
    MOST_STEPS,
    WIDEST,
    Spread,
    at_spread,
    best_spreads,
    cholesky_root,
    inverted,
    newton_step,
)
from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.identification.noise_structure import Weights
from tulip_testbed.identification.residual_noise import solve_triangular

QUIETEST = np.log(0.05)  # of a scale of the noise: less leaves residuals without any
CONVERGED = 1e-3  # of the log-likelihood: a step of less than a twentieth of a standard deviation
LITTLE = 0.5  # of the log-likelihood: a step of less is foretold and not made
FORETOLD = 1.5  # times what a step foretells it may gain: 0.8 to 1.1 in motions
ROUNDING = 1e-14  # of the largest information, that is lost where columns N are projected out
UNNOTICED = 1e-9  # of the information about a member whose prior s.d. is 1


@dataclass(frozen=True)
class LikelihoodFit:
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
        limited: whether some of the excess was left out, see `bounded`.
    """

    scales: np.ndarray
    spreads: np.ndarray
    scale_covariance: np.ndarray
    estimate: np.ndarray
    conditional: np.ndarray
    covariance: np.ndarray
    value: float
    log_evidence: float
    limited: bool


@dataclass(frozen=True)
class _Noise:
    """Terms that depend on ln sigma alone: V_0^-1, [N G y]' V_0^-1 [N G y] and the likelihood of V_0."""

    log_scale: np.ndarray
    weights: Weights
    gram: np.ndarray
    flat: np.ndarray
    flat_half: np.ndarray
    reduced: np.ndarray
    excess: np.ndarray
    moment: np.ndarray
    square: float
    value: float


_Joint = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]  # what `_joint` returns


def fit(problem: LinearProblem, start: tuple[np.ndarray, np.ndarray] | None = None) -> LikelihoodFit:
    """Estimate scales, spreads, base parameters and members.

    Args:
        start: sigma and tau from which the search begins; ones if None.

    Raises:
        numpy.linalg.LinAlgError: readings that are not finite, or columns N that are not independent.
    """
    small, shown = problem.in_use()
    noise, spread, joint, _ = _mode(small, start, CONVERGED)
    return _with_hidden(problem, shown, _result(small, noise, spread, joint or _joint(small, noise, spread)))


def least_nearby(
    problem: LinearProblem, start: tuple[np.ndarray, np.ndarray], beat: float = np.inf
) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
    """Return about the value at the mode, to compare similar problems, and sigma and tau there.

    From the mode of a similar problem one of Newton's steps mostly suffices: what the next would gain is
    little, and counted in the value without being made. So is a step that cannot win.

    Args:
        start: sigma and tau. beat: the least value of the problems that were compared before.

    Raises:
        numpy.linalg.LinAlgError: see `fit`.
    """
    small, _ = problem.in_use()
    noise, spread, _, gain = _mode(small, start, LITTLE, beat)
    value = _value(small, noise, spread, _posterior(small, noise, spread)[0])
    return value - gain, (np.exp(noise.log_scale), np.exp(spread.log_spread))


def _mode(
    problem: LinearProblem,
    start: tuple[np.ndarray, np.ndarray] | None,
    little: float,
    beat: float = np.inf,
) -> tuple[_Noise, Spread, _Joint | None, float]:
    """Go down by Newton's steps, until one gains less than a little of the log-likelihood or cannot win.

    Returns:
        the terms there, what `_joint` returns if that is known, and what the next step would gain.
    """
    k, f = len(problem.noise), len(problem.sizes)
    first = (np.zeros(k), np.zeros(f)) if start is None else (np.log(start[0]), np.log(start[1]))
    noise = _noise(problem, first[0])
    spread = best_spreads(problem, noise.reduced, noise.moment, first[1])
    limits = np.repeat([QUIETEST, -LIMIT], (k, f)), np.repeat([LIMIT, WIDEST], (k, f))
    for _ in range(MOST_STEPS):
        gradient, hessian, _ = joint = _joint(problem, noise, spread)
        step = newton_step(gradient, hessian, np.append(noise.log_scale, spread.log_spread), limits)
        at, value, gain = noise.log_scale, noise.value + spread.value, -0.5 * float(gradient @ step)
        if abs(gain) < little / 2 or value - FORETOLD * gain > beat:
            return noise, spread, joint, gain
        del joint
        del noise  # it is large: one at a time
        better = _on_the_way(problem, at, spread.log_spread, step, value)
        if better is None:
            noise = _noise(problem, at)
            break
        noise, spread = better
        del better
        if value - noise.value - spread.value < little:
            break
    return noise, spread, None, 0.0


def _on_the_way(
    problem: LinearProblem, log_scale: np.ndarray, log_spread: np.ndarray, step: np.ndarray, value: float
) -> tuple[_Noise, Spread] | None:
    """Return the first point on a step, halved again and again, that is no worse than its beginning.

    Args:
        value: at the beginning.
    """
    for shrink in 0.5 ** np.arange(HALVINGS):
        part = shrink * step
        noise = _noise(problem, np.clip(log_scale + part[: len(log_scale)], QUIETEST, LIMIT))
        spread = best_spreads(problem, noise.reduced, noise.moment, log_spread + part[len(log_scale) :])
        if noise.value + spread.value <= value:
            return noise, spread
    return None


def given(problem: LinearProblem, scales: np.ndarray, spreads: np.ndarray) -> LikelihoodFit:
    """Return the estimate with known scales (k,) and spreads (f,)."""
    small, shown = problem.in_use()
    noise = _noise(small, np.log(scales))
    spread = at_spread(small, noise.reduced, noise.moment, np.log(spreads))
    fitted = _with_hidden(problem, shown, _result(small, noise, spread, _joint(small, noise, spread)))
    return replace(fitted, scale_covariance=0 * fitted.scale_covariance, covariance=fitted.conditional)


def _with_hidden(problem: LinearProblem, shown: np.ndarray, fitted: LikelihoodFit) -> LikelihoodFit:
    """Return an estimate of some unknowns with the others, members of which nothing is known but the spread.

    Args:
        shown: which are estimated, (p + q,) bool.
    """
    estimate, at = np.zeros(len(shown)), np.ix_(shown, shown)
    estimate[shown] = fitted.estimate
    variance = np.append(np.zeros(problem.flat), np.repeat(fitted.spreads**2, problem.sizes))
    conditional, covariance = np.diag(variance), np.diag(variance)
    conditional[at], covariance[at] = fitted.conditional, fitted.covariance
    return replace(fitted, estimate=estimate, conditional=conditional, covariance=covariance)


def objective(
    problem: LinearProblem, log_scale: np.ndarray, log_spread: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return minus the logarithm of the restricted likelihood and the priors, and its gradient, (k + f,).

    Constants are left out.
    """
    noise = _noise(problem, log_scale)
    spread = at_spread(problem, noise.reduced, noise.moment, log_spread)
    return noise.value + spread.value, _joint(problem, noise, spread)[0]


def parts_of_variance(problem: LinearProblem, fitted: LikelihoodFit) -> np.ndarray:
    """Return the parts of the conditional covariance of nu, (2 + k + f, p, p).

    They are due to known information, fixed noise, each sigma_k and each tau_f. Without `excess` their sum is
    that covariance.
    """
    problem = problem.decorrelated()
    weights, p = problem.noise.weights(np.log(fitted.scales)), problem.flat
    # C Z' V_0^-1 K_k V_0^-1 Z C times sigma_k^2, in the rows of nu.
    of_nu = fitted.conditional[:p]
    across = weights(problem.whole @ np.column_stack([of_nu, np.zeros(p)]).T)
    flat = across.reshape(-1, p)
    pushed = chain([problem.noise.fixed @ across], weights.parts(across))
    parts = [of_nu[:, :p] @ problem.information @ of_nu[:, :p].T]
    parts += [flat.T @ part.reshape(-1, p) for part in pushed]
    for part, size in zip(problem.parts, fitted.spreads, strict=True):
        half = fitted.conditional[p:, :p][part] / size
        parts.append(half.T @ half)
    return np.array(parts)


def _noise(problem: LinearProblem, log_scale: np.ndarray) -> _Noise:
    weights = problem.noise.weights(log_scale)
    gram, p = weights.gram(problem.whole), problem.flat
    information = gram[:p, :p] + problem.information
    size = 1 / np.sqrt(np.diag(information))
    root, inverse_root, inverse = inverted(size[:, None] * information * size)
    half, _ = solve_triangular(root, size[:, None] * gram[:p, p:], lower=True)
    rest = gram[p:, p:] - half.T @ half
    excess = problem.excess
    if excess.any():
        least = np.exp(-2 * WIDEST) * np.eye(len(rest) - 1)  # of the prior at the largest spread
        excess = bounded(excess, rest[:-1, :-1] + least, problem.most_excess)
        at_about = excess @ problem.about
        noisy = np.block([[excess, at_about[:, None]], [at_about, problem.about @ at_about]])
        rest = rest - noisy
    logs = weights.log_volume + np.log(np.diag(root) / size).sum()
    prior = 0.5 * ((log_scale / problem.doubt) ** 2).sum()
    return _Noise(
        log_scale=log_scale,
        weights=weights,
        gram=gram,
        flat=size[:, None] * inverse * size,
        flat_half=inverse_root * size,
        reduced=_without_negative(rest[:-1, :-1]),
        excess=excess,
        moment=rest[:-1, -1],
        square=float(rest[-1, -1]),
        value=float(logs + 0.5 * rest[-1, -1] + prior),
    )


def _without_negative(information: np.ndarray) -> np.ndarray:
    """Return a matrix of information without the negative parts that rounding gave it."""
    try:  # less than this no prior of a member notices
        np.linalg.cholesky(information + UNNOTICED * np.eye(len(information)))
        return information
    except np.linalg.LinAlgError:
        pass
    if not np.isfinite(information).all():
        raise np.linalg.LinAlgError("found members whose columns are not finite")
    found = eigh(information, subset_by_value=(-np.inf, 0.0), check_finite=False)
    values, axes = map(np.asarray, found)
    return information - (axes * values) @ axes.T


def bounded(excess: np.ndarray, information: np.ndarray, most: float) -> np.ndarray:
    """Return the excess, in every direction at most a share of the information.

    With S the unit vectors of the members that have an excess, S E S', and T T' = S' I^-1 S, the share of the
    excess in the information has the eigenvalues of T' E T.
    """
    noisy = np.flatnonzero(excess.any(axis=0))
    own = excess[np.ix_(noisy, noisy)]
    whole, failed = cholesky_root(information, lower=True)
    if failed:  # a direction with so little information that rounding hides it
        values, axes = np.linalg.eigh(information)
        half = (axes / np.sqrt(np.maximum(values, ROUNDING * values[-1]))).T[:, noisy]
    else:
        half, _ = solve_triangular(whole, np.eye(len(information))[:, noisy], lower=True)
    root = np.linalg.cholesky(half.T @ half)
    share, turn = np.linalg.eigh(root.T @ own @ root)
    if share[-1] <= most:
        return excess
    back = np.linalg.solve(root.T, turn)
    out = np.zeros_like(excess)
    out[np.ix_(noisy, noisy)] = (back * np.minimum(share, most)) @ back.T
    return out


def _posterior(
    problem: LinearProblem, noise: _Noise, spread: Spread
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean and covariance of nu and phi with the scales known, (p + q,) and (p + q, p + q).

    Also return an upper triangle that makes the covariance, times its transpose.
    """
    p = problem.flat
    members = spread.root[:, None] * spread.shrinkage * spread.root
    carry = noise.flat @ noise.gram[:p, p:-1]
    cross = -carry @ members
    covariance = np.block([[noise.flat - cross @ carry.T, cross], [cross.T, members]])
    half = spread.root[:, None] * spread.half.T
    half = np.block([[noise.flat_half.T, -carry @ half], [np.zeros((len(half), p)), half]])
    phi = spread.root * spread.deviate
    nu = noise.flat @ (noise.gram[:p, -1] - noise.gram[:p, p:-1] @ phi)
    return np.concatenate([nu, phi]), covariance, half


def _joint(problem: LinearProblem, noise: _Noise, spread: Spread) -> _Joint:
    """Return gradient and Hessian in ln sigma and ln tau, and what the covariance needs too.

    Returns:
        gradient, (k + f,); Hessian, (k + f, k + f); estimate; conditional covariance; d estimate / d ln
        scales, (p + q, k + f).
    """
    k, p = len(problem.noise), problem.flat
    estimate, covariance, half = _posterior(problem, noise, spread)
    weighted = noise.weights((problem.whole @ np.append(-estimate, 1.0))[..., None])[..., 0]
    pushed = np.concatenate(
        [np.zeros((*weighted.shape, 0)), *noise.weights.parts(weighted[..., None])], axis=2
    )
    score, pairs = noise.weights.traces(problem.whole, half)
    score -= np.tensordot(weighted, pushed, axes=2)
    each = np.zeros((len(estimate), len(problem.parts)))  # members by families
    slope = np.zeros((len(estimate), k + len(problem.parts)))
    for j, part in enumerate(problem.parts):
        each[p:][part, j] = estimate[p:][part]
        slope[p:, k + j] = 2 * spread.root * (spread.shrinkage[:, part] @ spread.deviate[part])
    flat = pushed.reshape(weighted.size, k)
    solved = noise.weights(pushed).reshape(flat.shape)
    on_columns = (problem.whole.reshape(len(flat), -1).T @ solved)[:-1]
    doubtful = covariance @ on_columns
    hessian = np.zeros((k + len(problem.parts),) * 2)
    hessian[:k, :k] = 2 * (flat.T @ solved - on_columns.T @ doubtful)
    # Of noise that placements share there is little, and the average may be far from the Hessian.
    few = slice(k - len(pairs), k)
    hessian[few, few] += hessian[few, few] - 2 * pairs + np.diag(2 * score[few])
    hessian[:k, :k] += np.diag(problem.doubt**-2.0)
    score += noise.log_scale / problem.doubt**2
    hessian[:k, k:] = 2 * (on_columns - noise.gram[:-1, :-1] @ doubtful).T @ each
    known = [k + number for number in problem.known]
    hessian[:, known] = 0.0
    hessian[k:, :k] = hessian[:k, k:].T
    hessian[k:, k:] = spread.hessian
    slope[:, :k] = -2 * doubtful
    slope[:, known] = 0.0
    slope[:p, k:] = -noise.flat @ noise.gram[:p, p:-1] @ slope[p:, k:]
    return (np.concatenate([score, spread.gradient]), hessian, (estimate, covariance, slope))


def _value(problem: LinearProblem, noise: _Noise, spread: Spread, estimate: np.ndarray) -> float:
    """Return the value of a `LikelihoodFit` by the sum of squares of the residuals themselves.

    Far from where the columns hold, the difference of two large numbers is none, and the correction for their
    noise promises a better fit than a perfect one.
    """
    left = problem.whole @ np.append(-estimate, 1.0)
    nu = estimate[: problem.flat]
    square = np.vdot(left, noise.weights(left[..., None])[..., 0]) + nu @ problem.information @ nu
    square += spread.deviate @ spread.deviate
    return float(noise.value + spread.value + 0.5 * (square - (noise.square - spread.square)))


def _result(
    problem: LinearProblem,
    noise: _Noise,
    spread: Spread,
    joint: _Joint,
) -> LikelihoodFit:
    """Return the estimate at scales and spreads.

    Args:
        joint: what `_joint` returns there.
    """
    _, hessian, (estimate, conditional, slope) = joint
    # By their noise, columns let an estimate scatter more than the corrected information says.
    of_members = conditional[:, problem.flat :]
    conditional = conditional + of_members @ noise.excess @ of_members.T
    values, turn = np.linalg.eigh(hessian)
    doubt = (turn / np.maximum(values, LEAST_CURVATURE)) @ turn.T
    value = _value(problem, noise, spread, estimate)
    # A known spread has the curvature 1 and is not integrated over.
    volume = 0.5 * np.log(2 * np.pi / np.maximum(values, LEAST_CURVATURE)).sum()
    volume -= 0.5 * np.log(2 * np.pi) * len(problem.known)
    return LikelihoodFit(
        scales=np.exp(noise.log_scale),
        spreads=np.exp(spread.log_spread),
        scale_covariance=doubt,
        estimate=estimate,
        conditional=conditional,
        covariance=conditional + slope @ doubt @ slope.T,
        value=value,
        log_evidence=float(volume - value),
        limited=noise.excess is not problem.excess,
    )
