"""The information of a future experiment about explanations, in addition to the measurements so far.

The linear columns of base parameters, ordinary imperfections and explanations in the joint experiment give
the information on all of them. Noise is independent from placement to placement, so that informations add.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np
from scipy.linalg import solve

from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.families import families_in
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.linear_model import nuisances, weighed_precision
from tulip_testbed.calibration.member_columns import member_columns
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import SIZE, residuals, residuals_in_use, sensitivity
from tulip_testbed.identification.residual_noise import whitening

LEAST_SPREAD = 0.1  # tolerances: no family is known to be narrower
DRAWS = 400


@dataclass(frozen=True)
class Explanation:
    """One of several effects that explain a gap equally well.

    Attributes:
        log_bayes_factor: ln of it. gap: number of the gap, from 1.
    """

    instance: EffectInstance
    log_bayes_factor: float
    gap: int = 1

    @property
    def sizes(self) -> np.ndarray:
        """Return the numbers that a fit finds, (s,); 1 for an effect that is there or not."""
        effect = self.instance.effect
        return np.array([self.instance.values[k] for k in effect.sizes] or [1.0])

    @property
    def prior(self) -> np.ndarray:
        """Return the prior s.d. of the sizes, (s,)."""
        effect = self.instance.effect
        parameters = effect.parameters_on(self.instance.target)
        return np.array([parameters[k].prior for k in effect.sizes] or [1.0])


@dataclass(frozen=True)
class JointInformation:
    """Information of the measured placements and of each planned one.

    Attributes:
        measured: of all measured placements, (k, k).
        planned: of each planned placement, (n, k, k). numbers: of these placements, (n,).
        prior: what is known beforehand of each number, as one over its variance, (k,).
        columns: derivative of the residuals of the planned rows by all numbers, (m, 11, k).
        placement: of the planned rows, (m,).
        where: the columns of each explanation.
    """

    measured: np.ndarray
    planned: np.ndarray
    numbers: np.ndarray
    prior: np.ndarray
    columns: np.ndarray
    placement: np.ndarray
    where: tuple[slice, ...]

    def of_explanations(self, chosen: np.ndarray | None = None) -> np.ndarray:
        """Return the information on the sizes of all explanations, all else being estimated, (e, e).

        Args:
            chosen: planned placements that are measured too, by index; None: none.
        """
        whole = self.measured if chosen is None else self.measured + self.planned[chosen].sum(axis=0)
        first, (scale, nuisance) = self.where[0].start, self._scaled_nuisances(whole)
        across = scale[:, None] * whole[:first, first:]
        out = whole[first:, first:] - across.T @ solve(nuisance, across, assume_a="pos")
        return (out + out.T) / 2

    def _scaled_nuisances(self, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return scales and scaled information of everything but the explanations' sizes, (f,) and (f, f)."""
        first = self.where[0].start
        nuisance = whole[:first, :first] + np.diag(self.prior[:first])
        # A parameter that nothing determines is held: it tells nothing about the explanations either.
        scale = 1 / np.sqrt(np.maximum(np.diag(nuisance), 1e-300))
        return scale, scale[:, None] * nuisance * scale + 1e-10 * np.eye(first)

    def predictions(self, explanations: Sequence[Explanation], chosen: np.ndarray) -> np.ndarray:
        """Predict the mean residuals of the planned placements under each explanation, (n, 11).

        They are relative to the model that explains what was measured without any explanation.
        """
        first, (scale, nuisance) = self.where[0].start, self._scaled_nuisances(self.measured)
        rows, out = np.isin(self.placement, self.numbers[chosen]), []
        for one, where in zip(explanations, self.where, strict=True):
            given = scale[:, None] * self.measured[:first, where]
            moved = scale * (solve(nuisance, given, assume_a="pos") @ one.sizes)
            change = self.columns[rows][..., where] @ one.sizes - self.columns[rows][..., :first] @ moved
            out.append(change.mean(axis=0))
        return np.array(out)


def joint_information(
    observed: Observation,
    explanations: Sequence[Explanation],
    others: Sequence[EffectInstance],
    calibration: SelfCalibration,
    new: int,
) -> JointInformation:
    """Compute the information of a joint experiment.

    Args:
        observed: what was measured and what is planned.
        others: effects that explain other gaps.
        calibration: of what was measured: noise, base parameters and spreads of the families are taken from
            it.
        new: index of the planned experiment.
    """
    m, theta = observed.measurements, calibration.theta
    instances = [one.instance for one in explanations]
    families = families_in(observed, usual_tolerances(observed, None), [*instances, *others])
    spreads = {one.family.name: max(one.spread, LEAST_SPREAD) for one in calibration.families}
    slope = sensitivity(observed, theta)
    base = nuisances(observed, "AFTC")
    blocks, prior = [base], [np.zeros(base.shape[2])]
    prior[0][-1] = weighed_precision(observed) ** 2
    for family in (*families, *map(FreeEffect, others)):
        if not len(family):
            continue
        blocks.append(member_columns(observed, theta, slope, family))
        sd = np.sqrt(sum((part**2).sum(axis=1) for part in family.parts))
        prior.append(1 / (spreads.get(family.name, 1.0) * sd) ** 2)
    count, where = sum(block.shape[2] for block in blocks), []
    for one in explanations:
        blocks.append(_columns(observed, theta, slope, one.instance))
        where.append(slice(count, count + blocks[-1].shape[2]))
        count = where[-1].stop
        prior.append(np.zeros(blocks[-1].shape[2]))
    used = residuals_in_use(observed)[..., None]
    columns = np.concatenate(blocks, axis=2) * used
    white = whitening(observed, theta, calibration.noise)
    whole = white(columns)
    grams = np.array([whole[rows].T @ whole[rows] for rows, _, _ in white.blocks])
    number = np.unique(m.placement)
    planned = np.unique(m.placement[m.of_experiment == new])
    there = np.isin(number, planned)
    rows = m.of_experiment == new
    return JointInformation(
        measured=grams[~there].sum(axis=0),
        planned=grams[there],
        numbers=planned,
        prior=np.concatenate(prior),
        columns=columns[rows],
        placement=m.placement[rows],
        where=tuple(where),
    )


def _columns(
    observed: Observation, theta: np.ndarray, slope: np.ndarray, instance: EffectInstance
) -> np.ndarray:
    """Differentiate the residuals by the sizes of an effect, (m, 11, s); without a size, its whole change."""
    if instance.effect.sizes:
        return member_columns(observed, theta, slope, FreeEffect(instance))
    after = instance.effect.remove(observed, instance.target, instance.values)
    change = residuals(observed, theta) - residuals(after, theta)
    return change.reshape(len(observed), SIZE, 1)


def separations(explanations: Sequence[Explanation], information: np.ndarray) -> np.ndarray:
    """Compute the expected ln Bayes factor of each explanation, if it is true, over each other, (n, n).

    Args:
        information: on the sizes of all of them, (e, e).
    """
    n, at = len(explanations), _parts(explanations)
    out = np.zeros((n, n))
    for i, j in permutations(range(n), 2):
        own = information[at[j], at[j]] + np.diag(explanations[j].prior ** -2.0)
        sizes = explanations[i].sizes
        across = information[at[j], at[i]] @ sizes
        left = sizes @ information[at[i], at[i]] @ sizes - across @ np.linalg.solve(own, across)
        out[i, j] = 0.5 * max(float(left), 0.0)
    return out


def probabilities(log_bayes_factors: Sequence[float]) -> np.ndarray:
    """Return the posterior probabilities of equally probable explanations, (n,)."""
    logs = np.asarray(log_bayes_factors, float)
    share = np.exp(logs - logs.max())
    return share / share.sum()


def entropy(probability: np.ndarray) -> np.ndarray:
    """Compute the entropy of probabilities, (..., n) -> (...) [nats]."""
    safe = np.maximum(probability, 1e-300)
    return -(probability * np.log(safe)).sum(axis=-1)


def expected_entropy(
    explanations: Sequence[Explanation], before: np.ndarray, after: np.ndarray, rng: np.random.Generator
) -> float:
    """Compute the expected entropy of the explanations' posterior after an experiment [nats].

    Each explanation is taken as true in turn, its sizes as uncertain as they are now, and the pull of the new
    data on all sizes is drawn.

    Args:
        before, after: information on the sizes of all explanations without and with the experiment, (e, e).
    """
    at, now = _parts(explanations), probabilities([one.log_bayes_factor for one in explanations])
    values, turn = np.linalg.eigh(after - before)
    root = turn * np.sqrt(np.maximum(values, 0.0))
    total = 0.0
    for i, true in enumerate(explanations):
        known = before[at[i], at[i]] + np.diag(true.prior**-2.0)
        sizes = rng.multivariate_normal(true.sizes, np.linalg.inv(known), DRAWS, method="eigh")
        first = sizes @ before[at[i]]
        last = sizes @ after[at[i]] + rng.standard_normal((DRAWS, len(root))) @ root.T
        gain = np.stack(
            [
                _log_evidence(last[:, at[j]], after[at[j], at[j]], one.prior)
                - _log_evidence(first[:, at[j]], before[at[j], at[j]], one.prior)
                for j, one in enumerate(explanations)
            ],
            axis=1,
        )
        logs = np.log(np.maximum(now, 1e-300)) + gain
        share = np.exp(logs - logs.max(axis=1, keepdims=True))
        total += now[i] * float(entropy(share / share.sum(axis=1, keepdims=True)).mean())
    return total


def _log_evidence(pull: np.ndarray, information: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Compute ln of the Bayes factor of sizes by their pulls, (d, s) -> (d,)."""
    whole = information + np.diag(prior**-2.0)
    fitted = np.linalg.solve(whole, pull.T).T
    volume = np.linalg.slogdet(prior[:, None] * whole * prior)[1]
    return 0.5 * (pull * fitted).sum(axis=1) - 0.5 * volume


def _parts(explanations: Sequence[Explanation]) -> list[slice]:
    ends = np.cumsum([0, *(len(one.sizes) for one in explanations)]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]
