"""Pairs of effects that hide one another: each alone explains little, both together much.

Two plates that drift in opposite directions leave the sum of the forces as it is, for example. A search that
adds one effect at a time passes them by. By linear columns the evidence for all pairs takes a fraction of a
second: that for one effect times that for another where the first is known.
"""

import numpy as np

from tulip_testbed.discovery.candidates import Candidate, Fitted, log_choices
from tulip_testbed.discovery.columns import Changes, candidate_blocks
from tulip_testbed.discovery.evidence import marginal_fits
from tulip_testbed.discovery.joint_fit import JointFit

WIDE = 3.0  # plausible sizes: s.d. of the prior in a ranking, since effects that hide one another are large


def ranked_pairs(
    adopted: JointFit,
    others: list[Candidate],
    known: Changes,
    least: float,
    count: int,
    alike: bool = False,
) -> list[tuple[Fitted, Fitted]]:
    """Rank the pairs of candidates of which each is needed, at the points of their grids that are best alone.

    Args:
        adopted: the fit in addition to which they explain the experiment.
        known: see `candidate_columns`.
        least: ln of the Bayes factor that either has to gain where the other is known.
        count: of pairs, at most. alike: only pairs of one kind.

    Returns:
        the best first; sizes are those of each alone.
    """
    linear = adopted.partialled_out
    fits, columns = list[Fitted](), list[np.ndarray]()
    for block in candidate_blocks(linear, others, known):
        alone = marginal_fits(block, linear.residual)
        for fitted, points in zip(alone, block.projected, strict=True):
            if fitted.candidate.effect.sizes and fitted.detectable:
                fits.append(fitted)
                columns.append(points[fitted.point] * (WIDE * fitted.candidate.prior))
    if len(fits) < 2:
        return []
    n, size = len(fits), max(one.shape[1] for one in columns)
    flat = np.concatenate([*columns, np.zeros((len(linear.residual), 1))], axis=1)
    first = np.cumsum([0, *(one.shape[1] for one in columns[:-1])])
    where = np.full((n, size), flat.shape[1] - 1)  # what a candidate lacks is zero
    for k, one in enumerate(columns):
        where[k, : one.shape[1]] = first[k] + np.arange(one.shape[1])
    gram = (flat.T @ flat)[where[:, :, None, None], where]
    pull = (flat.T @ linear.residual)[where]
    own = gram[np.arange(n), :, np.arange(n)]
    price = np.array([log_choices(one.candidate, linear.observed) for one in fits])
    gained = np.empty((n, n))
    for k in range(n):
        shrunk = np.linalg.solve(np.eye(size) + own[k], gram[k].reshape(size, -1)).reshape(size, n, size)
        left = own - np.einsum("inj,ink->njk", gram[k], shrunk)
        gained[k] = _evidence(left, pull - np.einsum("i,inj->nj", pull[k], shrunk)) - price
    total = (_evidence(own, pull) - price)[:, None] + gained
    needed = np.triu(np.minimum(gained, gained.T) >= least, 1)
    if alike:
        kind = np.array([one.candidate.effect.name for one in fits])
        needed &= kind[:, None] == kind
    total[~needed] = -np.inf
    best = np.argsort(-total, axis=None)[: min(count, int(needed.sum()))]
    return [(fits[k], fits[j]) for k, j in zip(*np.unravel_index(best, total.shape), strict=True)]


def _evidence(gram: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """Compute ln of the Bayes factors of columns of one prior s.d., (n, s, s) and (n, s)."""
    spread = np.eye(gram.shape[1]) + gram
    gain = (pull * np.linalg.solve(spread, pull[..., None])[..., 0]).sum(axis=1)
    return 0.5 * (gain - np.linalg.slogdet(spread)[1])
