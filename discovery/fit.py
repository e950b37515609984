"""The sizes of effects that are taken to be there, by Gauss-Newton through their predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from tulip_testbed.discovery.candidates import Candidate, columns
from tulip_testbed.discovery.linear_model import Linear, linear_model
from tulip_testbed.effects.effect import Values
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import packed, unpacked
from tulip_testbed.identification.residual_noise import Noise

STEPS = 6
ANGLE_STEP = 1e-5  # rad or m, of differences
FORCE_STEP = 1e-2  # N
NEGLIGIBLE = 1e-9
TOLD = 1.0  # information on a size, in units of the prior's, from which the data speak for themselves
CONVERGED = 1e-3  # posterior s.d.


@dataclass(frozen=True)
class Term:
    """A candidate with its sizes, (s,), at a point of its grid."""

    candidate: Candidate
    point: int
    sizes: np.ndarray

    @property
    def values(self) -> Values:
        return self.candidate.values(self.sizes, self.point)

    @property
    def instance(self) -> EffectInstance:
        """The same without what a search needs."""
        return EffectInstance(self.candidate.effect, self.candidate.target, self.values)

    def removed(self, observed: Observation) -> Observation:
        """Readings without the effect."""
        return self.candidate.effect.predict(observed, self.candidate.target, self.values)


@dataclass(frozen=True)
class Fit:
    """Terms fitted to an experiment.

    Attributes:
        terms: with their sizes (maximum a posteriori).
        covariance: of all sizes, (s, s).
        linear: the experiment freed of the terms.
        columns: of the terms, whitened and projected, (r + 1, s).
        residual: whitened and projected, of the freed experiment, (r + 1,).
        log_bayes_factor: against no effect, in the coordinates of `about`.
    """

    terms: tuple[Term, ...]
    covariance: np.ndarray
    linear: Linear
    columns: np.ndarray
    residual: np.ndarray
    log_bayes_factor: float

    @property
    def chi_square(self) -> float:
        return float(self.residual @ self.residual)


def removed(observed: Observation, smooth: Observation, terms: Sequence[Term]) -> Observation:
    """Readings without the terms.

    How much a term takes away is taken from readings without noise, since the noise would go with the
    residual it is held against; a term without a size (channels exchanged) is undone as it is.
    """
    for term in terms:
        if not term.candidate.effect.sizes:
            observed, smooth = term.removed(observed), term.removed(smooth)
    clean = smooth
    for term in _undoing(terms):
        if term.candidate.effect.sizes:
            clean = term.removed(clean)
    change = packed(clean) - packed(smooth)
    return replace(unpacked(observed, packed(observed) + change), tree=clean.tree, cells=clean.cells)


def _undoing(terms: Sequence[Term]) -> list[Term]:
    """Terms in the order in which they are undone: the last to act first."""
    return sorted(terms, key=lambda term: -term.candidate.effect.stage)


def search(linear: Linear, terms: Sequence[Term], bend: np.ndarray | None = None) -> Fit:
    """Fit the terms about one linear model, whose noise and nuisances stay as they are.

    Args:
        terms: where to start.
        bend: what stays of the terms in the laboratory when they are taken away as predicted: by their
            sizes and, last, whatever these are, (m, 11, s + 1); None: the predictions hold.
    """
    terms = tuple(terms)
    prior = np.concatenate([term.candidate.prior for term in terms])
    positive = np.concatenate([term.candidate.positive for term in terms])
    more = (
        np.zeros((len(linear.residual), len(prior) + 1))
        if bend is None
        else linear.project(linear.white(bend))
    )
    before = linear.residual
    residual, gram, matrix = before, np.eye(len(prior)), np.zeros((len(before), len(prior)))
    for _ in range(STEPS if len(prior) else 0):
        matrix = linear.project(_joint_columns(linear, terms)) + more[:, :-1]
        residual = _left(linear, terms, more)
        sizes = np.concatenate([term.sizes for term in terms])
        gram = matrix.T @ matrix + np.diag(prior**-2.0)
        step = np.linalg.solve(gram, matrix.T @ residual - sizes / prior**2)
        moved = np.where(positive, np.maximum(sizes + step, 0.0), sizes + step)
        done = (np.abs(moved - sizes) < CONVERGED * np.sqrt(np.diag(np.linalg.inv(gram)))).all()
        terms = _sized(terms, moved)
        if done:
            break
    sizes = np.concatenate([term.sizes for term in terms])
    residual = _left(linear, terms, more)
    covariance = np.linalg.inv(gram)
    gained = before @ before - residual @ residual - ((sizes / prior) ** 2).sum()
    volume = np.linalg.slogdet(prior[:, None] * gram * prior)[1]
    log = 0.5 * gained - 0.5 * volume
    if positive.any():
        spread = np.sqrt(np.diag(covariance))
        log += float((norm.logcdf(sizes / spread) + np.log(2))[positive].sum())
    return Fit(terms, covariance, linear, matrix, residual, float(log))


def _left(linear: Linear, terms: tuple[Term, ...], more: np.ndarray) -> np.ndarray:
    """Whitened, projected residual without the terms, (r + 1,)."""
    left = linear.at(removed(linear.observed, linear.smooth, terms))
    # What the laboratory adds to terms that are taken away already is in the residual, not in the readings.
    return left - more @ with_constant(terms) + (linear.residual - linear.at(linear.observed))


def with_constant(terms: Sequence[Term]) -> np.ndarray:
    """All sizes and a one, (s + 1,)."""
    return np.concatenate([*(term.sizes for term in terms), [1.0]])


def _joint_columns(linear: Linear, terms: tuple[Term, ...]) -> np.ndarray:
    """Columns of every term about its sizes, of readings freed of the others, (r, s)."""
    out = []
    for k, term in enumerate(terms):
        others = terms[:k] + terms[k + 1 :]
        clean = linear.smooth
        for other in _undoing(others):
            clean = other.removed(clean)
        about = replace(linear, smooth=clean) if others else linear
        out.append(columns(about, term.candidate, term.point, term.sizes))
    return np.concatenate(out, axis=1)


def _sized(terms: tuple[Term, ...], sizes: np.ndarray) -> tuple[Term, ...]:
    parts = np.split(sizes, np.cumsum([len(term.sizes) for term in terms])[:-1])
    return tuple(replace(term, sizes=part) for term, part in zip(terms, parts, strict=True))


def through_effects(smooth: Observation, terms: Sequence[Term]) -> np.ndarray | None:
    """Derivative of all fields of the freed experiment by the readings, (m, k, n_joints + 14).

    A sole yields with the load that noisy cells tell: what is taken away errs with them. Without this,
    sizes of such effects come out too small (attenuation). None where nothing of the kind is taken away.
    """
    start, n = packed(smooth), smooth.joint_angles.shape[1]
    plain = packed(removed(smooth, smooth, terms)) - start
    steps = np.concatenate([np.full(n, ANGLE_STEP), np.full(8, FORCE_STEP), np.full(6, ANGLE_STEP)])
    out = np.zeros((*start.shape, n + 14))
    for k, step in enumerate(steps):
        moved = start.copy()
        moved[:, k] += step
        other = unpacked(smooth, moved)
        out[..., k] = (packed(removed(other, other, terms)) - moved - plain) / step
    if np.abs(out).max(initial=0.0) < NEGLIGIBLE:
        return None
    out[:, np.arange(n + 14), np.arange(n + 14)] += 1.0
    # What a faulty cell makes of a reading it makes of its noise too: undone, the noise is as stated.
    cells = slice(n, n + 8)
    out[:, cells, cells] = np.eye(8)
    return out


def _unshrunk(found: Fit) -> Fit:
    """Sizes as the data alone have them, where these say more than the prior.

    The prior weighs explanations against one another. An effect that is taken to be there is as large as it
    is: pulled towards zero, its interval would not hold the truth as often as it says.
    """
    prior = np.concatenate([term.candidate.prior for term in found.terms])
    if not len(prior):
        return found
    positive = np.concatenate([term.candidate.positive for term in found.terms])
    values, turn = np.linalg.eigh(prior[:, None] * (found.columns.T @ found.columns) * prior)
    told = values > TOLD
    sizes = turn.T @ (np.concatenate([term.sizes for term in found.terms]) / prior)
    known = np.maximum(values, TOLD)
    sizes = prior * (turn @ np.where(told, sizes * (known + 1) / known, sizes))
    spread = (turn * np.where(told, 1 / known, 1 / (np.maximum(values, 0.0) + 1))) @ turn.T
    sizes = np.where(positive, np.maximum(sizes, 0.0), sizes)
    return replace(found, terms=_sized(found.terms, sizes), covariance=prior[:, None] * spread * prior)


def fit(observed: Observation, noise: Noise, terms: Sequence[Term], bend: np.ndarray | None = None) -> Fit:
    """Fit terms with all that depends on them taken anew: noise, base parameters, smoothed readings.

    The residual, columns and linear model of what is returned belong to the freed experiment.

    Args:
        bend: see `search`.
    """
    terms = tuple(terms)
    if not terms:
        linear = linear_model(observed, noise)
        empty = np.zeros((len(linear.residual), 0))
        return Fit((), np.zeros((0, 0)), linear, empty, linear.residual, 0.0)
    smooth, clean = observed, None
    for _ in range(2):
        linear = linear_model(
            removed(observed, observed, terms),
            noise,
            smooth=clean,
            rounds=2 if clean is None else 1,
            through=through_effects(smooth, terms),
            beside=_beside(bend, terms),
        )
        errors = packed(linear.observed) - packed(linear.smooth)
        smooth = unpacked(observed, packed(observed) - errors)
        about = replace(linear, observed=observed, smooth=smooth)
        about = replace(about, residual=about.at(observed))
        found = _unshrunk(search(about, terms, bend))
        terms = found.terms
        clean = removed(smooth, smooth, terms)
    final = linear_model(
        removed(observed, observed, terms),
        noise,
        smooth=clean,
        rounds=1,
        through=through_effects(smooth, terms),
        beside=_beside(bend, terms),
    )
    return replace(found, linear=final, residual=final.residual)


def _beside(bend: np.ndarray | None, terms: Sequence[Term]) -> np.ndarray | None:
    """What the laboratory shows beside the predictions at the terms' sizes, (m, 11)."""
    return None if bend is None else bend @ with_constant(terms)
