"""Fit the sizes of several effects together, by Gauss-Newton through their predictions."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tulip_testbed.calibration.linear_model import Background, LinearModel, linear_model
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.columns import effect_columns
from tulip_testbed.effects.size_prior import log_tail, prior_sd
from tulip_testbed.identification.distributions import normal_logcdf
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    difference,
    fields,
    moved_by,
    packed,
    residuals,
    unpacked,
)
from tulip_testbed.identification.residual_noise import Noise

STEPS = 6
READING_STEPS = {"joint_angles": 1e-5, "cell_forces": 1e-2, "plate_poses": 1e-5}  # of differences [SI]
NEGLIGIBLE = 1e-9
INFORMED = 1.0  # information on a size over that of its prior, from which the data alone determine it
CONVERGED = 1e-3  # posterior s.d.


@dataclass(frozen=True, eq=False)
class Data:
    """An experiment and its noise, to which effects are fitted.

    Attributes:
        observed: the readings with ordinary imperfections removed.
        background: what is still uncertain about those; None: everything is taken as exact.
    """

    observed: Observation
    noise: Noise
    background: Background | None = None

    @property
    def null(self) -> JointFit:
        """Fit without any effect; it is not kept, because a fit holds its data."""
        linear = linear_model(self.observed, self.noise, background=self.background)
        empty = np.zeros((len(linear.residual), 0))
        return JointFit(self, (), np.zeros((0, 0)), linear, empty, linear.residual, 0.0)


@dataclass(frozen=True, eq=False)
class JointFit:
    """Effects fitted together to an experiment.

    Attributes:
        data: what they were fitted to.
        terms: the effects with their sizes (maximum a posteriori).
        covariance: of all sizes, (s, s).
        linear: the experiment with the terms removed.
        columns: of the terms, whitened and projected, (r + 1, s).
        residual: of the experiment with the terms removed, whitened and projected, (r + 1,).
        log_bayes_factor: ln of the Bayes factor against no effect, about one linear model.
    """

    data: Data
    terms: tuple[Fitted, ...]
    covariance: np.ndarray
    linear: LinearModel
    columns: np.ndarray
    residual: np.ndarray
    log_bayes_factor: float

    @property
    def chi_square(self) -> float:
        """Return the sum of squares of the residual."""
        return float(self.residual @ self.residual)

    @property
    def labels(self) -> list[str]:
        """Return the labels of the terms."""
        return [term.label for term in self.terms]

    @property
    def sizes(self) -> np.ndarray:
        """Return the sizes of all terms, (s,)."""
        return _joined([term.sizes for term in self.terms])

    @property
    def plausible(self) -> np.ndarray:
        """Return the plausible size of all sizes, (s,)."""
        return _joined([term.candidate.prior for term in self.terms])

    @property
    def prior(self) -> np.ndarray:
        """Return the standard deviation of all sizes in place of their prior, (s,); see `size_prior`."""
        return prior_sd(self.plausible, self.sizes)

    @property
    def positive(self) -> np.ndarray:
        """Return which sizes cannot be negative, (s,) bool."""
        return _joined([term.candidate.positive for term in self.terms]).astype(bool)

    @property
    def errors(self) -> list[np.ndarray]:
        """Return the standard errors of each term's sizes, (s,) each."""
        ends = np.cumsum([len(term.sizes) for term in self.terms])[:-1]
        return np.split(np.sqrt(np.diag(self.covariance)), ends)

    @cached_property
    def ranked(self) -> dict[Hashable, list[Fitted]]:
        """Return what was found to explain most in addition to the terms, by what was searched."""
        return {}

    def without(self, k: int) -> JointFit:
        """Fit the other terms again without term k."""
        return joint_fit(self.data, self.terms[:k] + self.terms[k + 1 :])

    @cached_property
    def partialled_out(self) -> LinearModel:
        """Return the linear model in which the terms are nuisances: their sizes may still change."""
        linear = self.linear
        if not self.columns.shape[1]:
            return linear
        basis = np.linalg.qr(self.columns)[0]
        whole = np.concatenate([linear.basis, basis], axis=1)
        residual = self.residual - basis @ (basis.T @ self.residual)
        return replace(linear, basis=np.linalg.qr(whole)[0], residual=residual)


def log_share_of_positive(sizes: np.ndarray, errors: np.ndarray, positive: np.ndarray) -> float:
    """Compute what ln of the evidence gains where sizes cannot be negative: their prior is half as wide.

    Args:
        sizes, errors: estimates and standard errors, (s,). positive: which cannot be negative, (s,) bool.
    """
    return float((normal_logcdf(sizes / errors) + np.log(2))[positive].sum())


def joint_fit(data: Data, terms: Sequence[Fitted]) -> JointFit:
    """Fit terms and estimate all that depends on them again: noise covariance, base parameters, smoothing.

    Args:
        terms: at the sizes where the search starts.

    Returns:
        the fit; its residual, columns and linear model are those of the experiment with the terms removed.
    """
    terms, observed = tuple(terms), data.observed
    if not terms:
        return data.null
    smoothed, clean = observed, None

    def without_terms(rounds: int) -> LinearModel:
        return linear_model(
            remove_terms(observed, observed, terms),
            data.noise,
            smoothed=clean,
            rounds=rounds,
            propagation=propagation(smoothed, terms),
            background=data.background,
        )

    for _ in range(2):
        linear = without_terms(2 if clean is None else 1)
        errors = packed(linear.observed) - packed(linear.smoothed)
        smoothed = unpacked(observed, packed(observed) - errors)
        about = replace(linear, observed=observed, smoothed=smoothed)
        about = replace(about, residual=about.residual_of(observed))
        found = _unshrunk(gauss_newton(about, terms))
        terms = found.terms
        clean = remove_terms(smoothed, smoothed, terms)
    final = without_terms(1)
    return replace(found, data=data, linear=final, residual=final.residual)


def gauss_newton(linear: LinearModel, terms: Sequence[Fitted]) -> JointFit:
    """Fit the sizes about one linear model, whose noise and nuisance parameters stay as they are.

    Args:
        terms: at the sizes where the search starts.
    """
    terms = tuple(terms)
    plausible = _joined([term.candidate.prior for term in terms])
    prior = plausible
    positive = _joined([term.candidate.positive for term in terms]).astype(bool)
    before = linear.residual
    residual, gram, matrix = before, np.eye(len(prior)), np.zeros((len(before), len(prior)))
    for _ in range(STEPS if len(prior) else 0):
        matrix = linear.project(_joint_columns(linear, terms))
        residual = _residual_without(linear, terms)
        sizes = _joined([term.sizes for term in terms])
        prior = prior_sd(plausible, sizes)
        gram = matrix.T @ matrix + np.diag(prior**-2.0)
        step = np.linalg.solve(gram, matrix.T @ residual - sizes / prior**2)
        moved = np.where(positive, np.maximum(sizes + step, 0.0), sizes + step)
        done = (np.abs(moved - sizes) < CONVERGED * np.sqrt(np.diag(np.linalg.inv(gram)))).all()
        terms = _with_sizes(terms, moved)
        if done:
            break
    sizes = _joined([term.sizes for term in terms])
    residual = _residual_without(linear, terms)
    covariance = np.linalg.inv(gram)
    gained = before @ before - residual @ residual - ((sizes / prior) ** 2).sum()
    volume = np.linalg.slogdet(prior[:, None] * gram * prior)[1]
    log = float(0.5 * gained - 0.5 * volume + log_tail(plausible, sizes).sum())
    log += log_share_of_positive(sizes, np.sqrt(np.diag(covariance)), positive)
    return JointFit(Data(linear.observed, linear.noise), terms, covariance, linear, matrix, residual, log)


def _joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([*parts, np.zeros(0)])


def _with_sizes(terms: tuple[Fitted, ...], sizes: np.ndarray) -> tuple[Fitted, ...]:
    parts = np.split(sizes, np.cumsum([len(term.sizes) for term in terms])[:-1])
    return tuple(Fitted(term.candidate, term.point, part) for term, part in zip(terms, parts, strict=True))


def _residual_without(linear: LinearModel, terms: tuple[Fitted, ...]) -> np.ndarray:
    """Compute the whitened, projected residual with the terms removed, (r + 1,)."""
    undone = [term for term in terms if not term.candidate.effect.sizes]
    observed, smoothed = (remove_terms(one, one, undone) for one in (linear.observed, linear.smoothed))
    clean = remove_terms(smoothed, smoothed, [term for term in terms if term.candidate.effect.sizes])
    # At the readings themselves, forces that are taken off would enlarge the noise of their centre.
    change = residuals(clean, linear.theta) - residuals(smoothed, linear.theta)
    return linear.project_residual(linear.whitening(residuals(observed, linear.theta) + change))


def _joint_columns(linear: LinearModel, terms: tuple[Fitted, ...]) -> np.ndarray:
    """Compute the columns of each term at its sizes, with the other terms removed, (r, s)."""
    out = []
    for k, term in enumerate(terms):
        others = terms[:k] + terms[k + 1 :]
        clean = linear.smoothed
        for other in _last_first(others):
            clean = other.removed(clean)
        about = replace(linear, smoothed=clean) if others else linear
        out.append(effect_columns(about, term.candidate, term.point, term.sizes))
    return np.concatenate(out, axis=1)


def _unshrunk(found: JointFit) -> JointFit:
    """Undo the prior's shrinkage of sizes on which the data say more than the prior.

    The prior serves to weigh explanations against one another. Intervals of shrunk sizes would hold the truth
    less often than they claim.
    """
    prior = found.prior
    if not len(prior):
        return found
    values, turn = np.linalg.eigh(prior[:, None] * (found.columns.T @ found.columns) * prior)
    informed = values > INFORMED
    sizes = turn.T @ (found.sizes / prior)
    known = np.maximum(values, INFORMED)
    sizes = prior * (turn @ np.where(informed, sizes * (known + 1) / known, sizes))
    spread = (turn * np.where(informed, 1 / known, 1 / (np.maximum(values, 0.0) + 1))) @ turn.T
    sizes = np.where(found.positive, np.maximum(sizes, 0.0), sizes)
    return replace(found, terms=_with_sizes(found.terms, sizes), covariance=prior[:, None] * spread * prior)


def remove_terms(observed: Observation, smoothed: Observation, terms: Sequence[Fitted]) -> Observation:
    """Return the observation with the terms removed.

    How much a term changes is computed from smoothed readings, because otherwise the noise would follow the
    residual with which it is compared. A term without a size (exchanged channels) is undone as it is.
    """
    for term in terms:
        if not term.candidate.effect.sizes:
            observed, smoothed = term.removed(observed), term.removed(smoothed)
    clean = smoothed
    for term in _last_first(terms):
        if term.candidate.effect.sizes:
            clean = term.removed(clean)
    return moved_by(observed, smoothed, clean)


def _last_first(terms: Sequence[Fitted]) -> list[Fitted]:
    """Return the terms in the order in which they are undone: the last to act first."""
    return sorted(terms, key=lambda term: -term.candidate.effect.stage)


def propagation(smoothed: Observation, terms: Sequence[Fitted]) -> np.ndarray | None:
    """Differentiate all fields of the experiment without the terms with respect to the readings.

    Noise propagates through a removal that depends on readings: a sole yields under the load that noisy cells
    show. Without this derivative the sizes of such effects would be attenuated.

    Returns:
        (m, k, n_joints + 14); None where no removal depends on readings.
    """
    plain = difference(smoothed, remove_terms(smoothed, smoothed, terms))

    def changed(name: str, change: np.ndarray) -> np.ndarray:
        other = smoothed.changed(**{name: getattr(smoothed, name) + change})
        return (difference(other, remove_terms(other, other, terms)) - plain) / READING_STEPS[name]

    out, first = np.zeros((*plain.shape, fields(smoothed)["plates"].stop)), 0
    for name, step in READING_STEPS.items():
        shape = getattr(smoothed, name).shape[1:]
        every = np.eye(int(np.prod(shape)))
        # All at once, by steps whose effects do not cancel: most removals depend on none.
        apart = step * (1 + 0.5 * np.sin(np.arange(len(every)))).reshape(shape)
        if np.abs(changed(name, apart)).max(initial=0.0) >= NEGLIGIBLE:
            for k, one in enumerate(every):
                out[..., first + k] = changed(name, step * one.reshape(shape))
        first += len(every)
    if np.abs(out).max(initial=0.0) < NEGLIGIBLE:
        return None
    at, every = fields(smoothed), np.arange(out.shape[2])
    out[:, every, every] += 1.0
    # A faulty cell scales its noise as its reading; with the fault undone, the noise is as stated.
    out[:, at["cells"], at["cells"]] = np.eye(at["cells"].stop - at["cells"].start)
    # An angle that is restored without its encoder has the noise of what tells it, assumed to be as large.
    joints = every[at["angles"]]
    own = out[:, joints, joints]
    out[:, joints, joints] = np.where(np.abs(own) < NEGLIGIBLE, 1.0, own)
    return out
