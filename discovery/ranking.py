"""Candidates against what adopted terms leave: the foremost are looked at again without linearising."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from tulip_testbed.discovery.candidates import Candidate, columns
from tulip_testbed.discovery.evidence import Score, score
from tulip_testbed.discovery.fit import TOLD, Fit, Term, fit, search
from tulip_testbed.discovery.linear_model import Linear
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_noise import Noise

SHORTLIST = 12
WITHIN = 15.0  # ln of the Bayes factor by linear columns, of what is looked at again without linearising
CLOSE = 10.0  # the same, of what is fitted with the noise taken anew
KINDS = 4  # of effects, at most, for which that is done
STEPS_IN_TIME = 60


@dataclass(frozen=True)
class Rival:
    """An explanation of one gap, beside the adopted one.

    Attributes:
        log_bayes_factor: against no effect, the other adopted ones being there.
    """

    term: Term
    log_bayes_factor: float

    @property
    def label(self) -> str:
        return self.term.candidate.label


def best_of(
    observed: Observation, noise: Noise, found: Fit, ranked: list[Score], bend: np.ndarray | None = None
) -> Rival | None:
    """The best of a ranking; of different kinds that are near, the one that explains most with noise anew.

    Args:
        bend: what the predictions of the terms found miss in the laboratory, see `laboratory.refit`.
    """
    rivals = again(found, ranked)
    kinds: dict[str, Rival] = {}
    for rival in rivals:
        if rival.log_bayes_factor > rivals[0].log_bayes_factor - CLOSE:
            kinds.setdefault(rival.term.candidate.effect.name, rival)
    near = list(kinds.values())[:KINDS]
    if len(near) < 2:
        return near[0] if near else None
    alone = worth(fit(observed, noise, found.terms, bend))
    tried = []
    for rival in near:
        more = bend
        if bend is not None:
            unbent = np.zeros((*bend.shape[:2], len(rival.term.sizes)))
            more = np.concatenate([bend[..., :-1], unbent, bend[..., -1:]], axis=-1)
        tried.append(worth(fit(observed, noise, (*found.terms, rival.term), more)) - alone)
    best = int(np.argmax(tried))
    return replace(near[best], log_bayes_factor=tried[best])


def worth(found: Fit) -> float:
    """Ln of the evidence for all terms, up to what is common to all fits of an experiment.

    By what is left, since the noise is taken anew in every fit; less what the choice of times costs.
    """
    out = -0.5 * (found.chi_square + found.linear.white.log_volume)
    out -= sum(price(found.linear, term.candidate) for term in found.terms)
    if not found.columns.shape[1]:
        return out
    prior = np.concatenate([term.candidate.prior for term in found.terms])
    positive = np.concatenate([term.candidate.positive for term in found.terms])
    sizes = np.concatenate([term.sizes for term in found.terms])
    told, turn = np.linalg.eigh(prior[:, None] * (found.columns.T @ found.columns) * prior)
    told = np.maximum(told, 0.0)
    # Where the data say more than the prior, sizes are the data's own (`fit`) and less is left.
    shrunk = np.where(told > TOLD, told / (1 + told), 1.0)
    out -= 0.5 * float((shrunk * (turn.T @ (sizes / prior)) ** 2 + np.log1p(told)).sum())
    spread = np.sqrt(np.diag(found.covariance))
    return out + float((norm.logcdf(sizes / spread) + np.log(2))[positive].sum())


def again(found: Fit, ranked: list[Score]) -> list[Rival]:
    """The foremost of a ranking with their sizes found without linearising, the best first."""
    if not ranked or not np.isfinite(ranked[0].log_bayes_factor):
        return []
    near = [s for s in ranked if s.log_bayes_factor > 0.8 * ranked[0].log_bayes_factor - WITHIN and s.visible]
    out = []
    for s in near[:SHORTLIST]:
        term, cost = _in_time(found.linear, s, found.residual, found.columns)
        tried = search(about_fit(found), (term,))
        out.append(Rival(tried.terms[0], tried.log_bayes_factor - cost))
    return sorted(out, key=lambda rival: -rival.log_bayes_factor)


def about_fit(found: Fit) -> Linear:
    """The freed experiment, in which what is adopted already may still change its sizes."""
    linear = found.linear
    if not found.columns.shape[1]:
        return linear
    basis = np.linalg.qr(found.columns)[0]
    whole = np.concatenate([linear.basis, basis], axis=1)
    residual = found.residual - basis @ (basis.T @ found.residual)
    return replace(linear, basis=np.linalg.qr(whole)[0], residual=residual)


def _in_time(linear: Linear, s: Score, residual: np.ndarray, taken: np.ndarray) -> tuple[Term, float]:
    """A term at its best time, and what the choice costs: ln of the number of times there were.

    A change in time is between two postures; the grid is too coarse to say between which.
    """
    candidate, cost = s.candidate, price(linear, s.candidate)
    timed, middles = _times(linear, candidate)
    if not len(middles):
        return Term(candidate, s.point, s.sizes), cost
    chosen = candidate.settings[s.point]
    near = middles[np.argsort(np.abs(middles - chosen[timed]))[:STEPS_IN_TIME]]
    settings = np.repeat(chosen[None], len(near), axis=0)
    settings[:, timed] = near
    finer = replace(candidate, settings=settings)
    basis = np.linalg.qr(taken)[0] if taken.shape[1] else None
    points = []
    for point in range(len(near)):
        column = linear.project(columns(linear, finer, point))
        points.append(column if basis is None else column - basis @ (basis.T @ column))
    best = score(finer, points, residual)
    return Term(finer, best.point, best.sizes), cost


def _times(linear: Linear, candidate: Candidate) -> tuple[int, np.ndarray]:
    """Number of the parameter that is a time, and the times there are: between two postures each, (t,)."""
    timed = [k for k, p in enumerate(candidate.effect.parameters) if p.grid and not p.choices]
    if not timed:
        return -1, np.zeros(0)
    part, grid = np.unique(linear.observed.part), candidate.effect.parameters[timed[0]].grid
    middles = (part[1:] + part[:-1]) / 2
    return timed[0], middles[(middles >= min(grid)) & (middles <= max(grid))]


def price(linear: Linear, candidate: Candidate) -> float:
    """Ln of how many times, or points of a grid, there were to choose from."""
    _, middles = _times(linear, candidate)
    return float(np.log(len(middles) or len(candidate.settings)))
