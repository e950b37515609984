"""The evidence for each candidate alone, and the level of a test among many.

With the noise known, an effect with sizes phi ~ N(0, T^2) explains the projected residual r by its
projected columns G with the Bayes factor ln BF = b'(A + T^-2)^-1 b / 2 - ln|I + T A T| / 2, A = G'G,
b = G'r. T and a correction are those of `size_prior`; a size that cannot be negative has half of it.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from scipy.special import chdtrc, log_ndtr

from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.columns import Columns, Moments
from tulip_testbed.effects.size_prior import log_tail, prior_sd

DETECTABLE = 0.5  # smallest singular value times prior s.d. that an experiment can show
DRAWS = 400
WIDENINGS = 2  # of the normal distribution in place of a prior
Weighed = tuple[Candidate, list[Moments]]  # by point of its grid
STACKED = 500  # candidates at a time whose gains are computed together


def ranked(blocks: Iterable[Columns], residual: np.ndarray) -> list[Fitted]:
    """Fit each candidate alone to a projected residual, (r + 1,); the best first."""
    pairs = [pair for columns in blocks for pair in _weighed(columns, residual[:, None])]
    return sorted(_fits(pairs), key=lambda fitted: -fitted.log_bayes_factor)


def fitted_and_counted(
    blocks: Iterable[Columns], residual: np.ndarray, rng: np.random.Generator, draws: int = DRAWS
) -> tuple[list[Fitted], float]:
    """Fit each candidate alone, in order, and estimate the effective number of independent tests."""
    pairs: list[Weighed] = []

    def on_noise(columns: Columns, noise: np.ndarray) -> Iterator[Weighed]:
        for candidate, points in _weighed(columns, np.column_stack([residual, noise])):
            pairs.append((candidate, [(gram, pull[:, :1].copy()) for gram, pull in points]))
            yield candidate, [(gram, pull[:, 1:]) for gram, pull in points]

    tests = effective_tests(blocks, rng, draws, on_noise)
    return _fits(pairs), tests


def marginal_fits(columns: Columns, residual: np.ndarray) -> list[Fitted]:
    """Fit each candidate alone to a projected residual, at the best point of its grid.

    Args:
        residual: whitened and projected, (r + 1,).

    Returns:
        the posterior means of the sizes, in the order of the candidates. Bayes factors are averaged over the
        grid.
    """
    return _fits(list(_weighed(columns, residual[:, None])))


def _weighed(columns: Columns, whitened: np.ndarray) -> Iterator[Weighed]:
    """Yield candidates with their moments with whitened residuals, (r + e, d)."""
    yield from zip(columns.candidates, columns.moments(whitened), strict=True)


def _fits(pairs: list[Weighed]) -> list[Fitted]:
    """Fit candidates, with all of as many sizes at once."""
    out: dict[int, Fitted] = {}
    for count in {len(candidate.effect.sizes) for candidate, _ in pairs}:
        alike = [k for k, (candidate, _) in enumerate(pairs) if len(candidate.effect.sizes) == count]
        fit = _with_sizes if count else _without_sizes
        out |= zip(alike, fit([pairs[k] for k in alike]), strict=True)
    return [out[k] for k in range(len(pairs))]


def _with_sizes(pairs: list[Weighed]) -> Iterator[Fitted]:
    """Fit candidates with equally many sizes."""
    flat = [(candidate, one) for candidate, points in pairs for one in points]
    plausible = np.array([candidate.prior for candidate, _ in flat])
    positive = np.array([candidate.positive for candidate, _ in flat])
    gram = np.array([gram for _, (gram, _) in flat])
    pull = np.array([pull[:, 0] for _, (_, pull) in flat])
    visible = np.linalg.eigvalsh(plausible[:, :, None] * gram * plausible[:, None, :]).max(axis=1)
    detectable = visible > DETECTABLE**2
    about = plausible
    for _ in range(WIDENINGS):
        about = _times(_posterior(prior_sd(plausible, about), gram)[0], pull)
    covariance, volume = _posterior(prior_sd(plausible, about), gram)
    sizes = _times(covariance, pull)
    free = _times(np.linalg.pinv(gram, hermitian=True), pull)
    gain = _dot(pull, free)
    # The prior of a positive size is a half normal: the allowed part of the posterior counts over a half.
    share = log_ndtr(sizes / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))) + np.log(2)
    log = 0.5 * (_dot(pull, sizes) - volume) + log_tail(plausible, about).sum(axis=1)
    log = log + np.where(positive, share, 0.0).sum(axis=1)
    gain = np.where((positive & (free <= 0)).any(axis=1), 0.0, gain)
    sizes = np.where(positive, np.maximum(sizes, 0.0), sizes)
    one_sided = positive.any(axis=1)
    p = np.where(gain > 0, chdtrc(plausible.shape[1], gain) / np.where(one_sided, 2, 1), 1.0)
    first = 0
    for candidate, points in pairs:
        at = slice(first, first + len(points))
        logs = np.where(detectable[at], log[at], -np.inf)
        point = int((logs if detectable[at].any() else log[at]).argmax())
        k, first = first + point, at.stop
        average = float(np.logaddexp.reduce(logs) - np.log(len(logs))) - candidate.price
        most = float(np.sqrt(max(visible[at].max(), 0.0)))
        yield Fitted(candidate, point, sizes[k], average, float(p[k]), most)


def _posterior(prior: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of the sizes, (n, s, s), and ln of the prior's volume over it, squared, (n,)."""
    spread = np.eye(prior.shape[1]) + prior[:, :, None] * gram * prior[:, None, :]
    covariance = prior[:, :, None] * np.linalg.inv(spread) * prior[:, None, :]
    return covariance, np.linalg.slogdet(spread)[1]


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices @ vectors[..., None])[..., 0]


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return (first[:, None, :] @ second[:, :, None])[:, 0, 0]


def _without_sizes(pairs: list[Weighed]) -> Iterator[Fitted]:
    """Weigh effects that have no size but are there or not: ln BF = g'r - g'g / 2."""
    for candidate, points in pairs:
        size = np.array([float(gram[0, 0]) for gram, _ in points])
        detectable = size > DETECTABLE**2  # exchanging a cell with itself changes nothing
        logs = np.array([float(pull[0, 0]) for _, pull in points]) - size / 2
        point = int(np.where(detectable, logs, -np.inf).argmax())
        gain = max(2 * float(logs[point]), 0.0)
        p = float(chdtrc(1, gain)) / 2 if gain > 0 else 1.0
        average = -np.inf
        if detectable.any():
            average = float(np.logaddexp.reduce(logs[detectable]) - np.log(detectable.sum()))
        most = float(np.sqrt(size.max()))
        yield Fitted(candidate, point, np.zeros(0), average, p, most)


def effective_tests(
    blocks: Iterable[Columns],
    rng: np.random.Generator,
    draws: int = DRAWS,
    weighed: Callable[[Columns, np.ndarray], Iterable[Weighed]] = _weighed,
) -> float:
    """Estimate the effective number of independent tests among correlated candidates.

    The smallest of n independent p-values has the median 1 - 2^(-1/n). That of the candidates is simulated
    on noise alone and solved for n.
    """
    noise: np.ndarray | None = None
    # Largest gain in each draw, by degrees of freedom and number of sides of the test.
    largest: dict[tuple[int, int], np.ndarray] = {}
    for columns in blocks:
        noise = rng.standard_normal((columns.count, draws)) if noise is None else noise
        for alike in _alike(weighed(columns, noise)):
            gain, key = _gains(alike)
            largest[key] = np.maximum(gain, largest.get(key, -np.inf))
    least = np.ones(draws)
    for (dof, sides), gain in largest.items():
        p = np.where(gain > -np.inf, chdtrc(dof, gain) * sides / 2, 1.0)
        least = np.minimum(least, p)
    # The median is estimated well from few draws. In the tail candidates are less correlated, so that a
    # nominal level of 0.5 % is in fact one of 0.6 to 0.8 %.
    low = float(np.quantile(least, 0.5))
    return float(np.log(0.5) / np.log1p(-low)) if low < 1 else 1.0


def _alike(pairs: Iterable[Weighed]) -> Iterator[list[tuple[Candidate, Moments]]]:
    """Yield candidates with moments at single points of their grids, those with alike sizes together."""
    out: dict[tuple[bool, bytes], list[tuple[Candidate, Moments]]] = {}
    for candidate, points in pairs:
        key = bool(candidate.effect.sizes), candidate.positive.tobytes()
        out.setdefault(key, []).extend((candidate, one) for one in points)
    for several in out.values():
        yield from (several[k : k + STACKED] for k in range(0, len(several), STACKED))


def _gains(alike: list[tuple[Candidate, Moments]]) -> tuple[np.ndarray, tuple[int, int]]:
    """Compute the largest gain in each draw of noise by candidates with alike sizes.

    Returns:
        gains, (draws,); degrees of freedom and sides of the test.
    """
    first = alike[0][0]
    gram, pull = (np.array([one[k] for _, one in alike]) for k in (0, 1))
    if not first.effect.sizes:
        gain = (2 * pull[:, 0] - gram[:, 0]).max(axis=0)
        return np.where(gain > 0, gain, -np.inf), (gram.shape[1], 1)
    prior = np.array([candidate.prior for candidate, _ in alike])
    visible = np.linalg.eigvalsh(prior[:, :, None] * gram * prior[:, None, :]).max(axis=1)
    free = np.linalg.pinv(gram, hermitian=True) @ pull
    possible = (visible > DETECTABLE**2)[:, None] & (free[:, first.positive] > 0).all(axis=1)
    gain = np.where(possible, (pull * free).sum(axis=1), -np.inf).max(axis=0)
    return gain, (gram.shape[1], 1 if first.positive.any() else 2)


def sidak(p: float, tests: float) -> float:
    """Adjust a p-value for the number of independent tests (Sidak 1967)."""
    return float(-np.expm1(tests * np.log1p(-min(p, 1 - 1e-16))))
