"""Self-calibration: base parameters and all ordinary imperfections in one estimate.

The residuals of all channels are linear about the current estimate,

    r = R(q) (theta - theta_0) + sum_f G_f (phi_f - phi_f0) + stances + weight + e,

with the members' columns at the readings without the members and without the noise as far as both are known.
`reml` estimates everything; then the members are removed at their estimate by the effects' own formulas and
the columns are computed anew, until nothing moves (Gauss-Newton).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from tulip_testbed.calibration.estimated_loads import with_estimated_loads
from tulip_testbed.calibration.families import Family, families_of, tolerances_of
from tulip_testbed.calibration.linearisation import (
    SOURCES,
    State,
    joint_compliance,
    linearised,
    mixing_of,
    scaled_noise,
    split_members,
)
from tulip_testbed.calibration.placement_blocks import placement_blocks
from tulip_testbed.calibration.reml import Fit, Problem, fit, given
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.identification.residual_noise import Noise, noise_of

ROUNDS = 12
HALF_95 = float(ndtri(0.975))  # half of a normal 95 % interval in s.d.
STANDS = 0.1  # s.e. by which nothing moves any more
PRIOR_ONLY = 0.5  # share of its prior's variance from which a member is known by its prior only


@dataclass(frozen=True)
class CalibratedFamily:
    """A family and the spread of its members.

    Attributes:
        spread: estimated s.d. of the members, in tolerances. spread95: its 95 % interval.
        value, standard_error: of every number of the family, (n,) [SI].
        interval95: low and high end, (n, 2) [SI]. determined: whether the data know it, (n,) bool.
    """

    family: Family
    spread: float
    spread95: tuple[float, float]
    value: np.ndarray
    standard_error: np.ndarray
    interval95: np.ndarray
    determined: np.ndarray

    @property
    def instances(self) -> list[EffectInstance]:
        """Return the members as effects with their intervals."""
        width = len(self.family.effect.parameters)
        intervals = [(low, high) for low, high in self.interval95.tolist()]
        return [
            replace(found, intervals=tuple(intervals[width * k : width * (k + 1)]))
            for k, found in enumerate(self.family.instances(self.value))
        ]


@dataclass(frozen=True)
class SelfCalibration:
    """Base parameters and members of an experiment.

    Attributes:
        observed: the readings with all members removed at their estimate.
        theta: base parameters, (p,) [m]. covariance: of theta, with everything that is uncertain, (p, p).
        sources: names of the parts of the variance. shares: parts of the variance of each parameter,
            (len(sources), p), with sum 1.
        interval_dof: degrees of freedom of each parameter's t interval, (p,).
        families: with their members. noise: with estimated scales.
        problem, solved: the linear model at the estimate.
        assumed: how the tolerances were found.
    """

    observed: Observation
    theta: np.ndarray
    covariance: np.ndarray
    sources: tuple[str, ...]
    shares: np.ndarray
    interval_dof: np.ndarray
    families: tuple[CalibratedFamily, ...]
    noise: Noise
    problem: Problem
    solved: Fit
    assumed: str

    @property
    def mixing(self) -> np.ndarray:
        """Return the members from the estimated deviates, (q, k) [SI]."""
        return mixing_of([c.family for c in self.families])[0]

    def keep(self, columns: Sequence[int]) -> SelfCalibration:
        """Return the estimate of a model with some of the base parameters, the others being zero.

        Args:
            columns: indices of the parameters, (k,).
        """
        p = len(self.theta)
        chosen = [*columns, p]
        problem = replace(
            self.problem,
            columns=self.problem.columns[..., chosen],
            information=self.problem.information[np.ix_(chosen, chosen)],
        )
        solved = fit(problem, (self.solved.scales, self.solved.spreads))
        return _result(
            self.observed, [c.family for c in self.families], self.noise, problem, solved, self.assumed
        )


def self_calibrate(
    observed: Observation, tolerances: Mapping[str, float] | None = None, rounds: int = ROUNDS
) -> SelfCalibration:
    """Estimate base parameters and members.

    Args:
        observed: the experiment.
        tolerances: of families, in place of those that fit the sensors [SI]; zero: exact.
        rounds: largest number of linearisations.

    Raises:
        InputError: an unknown family or an impossible tolerance.
        numpy.linalg.LinAlgError: readings that are not finite, or postures that do not suffice.
    """
    used = tolerances_of(observed.measurements.sensors, tolerances)
    families, noise = families_of(observed.nominal.robot, used), noise_of(observed)
    blocks = placement_blocks(observed)
    regressor = observed.geometry.regressor
    p = regressor.shape[2]
    start = residuals(observed, np.zeros(p))[:, :2]
    theta = np.linalg.lstsq(regressor.reshape(-1, p), start.ravel(), rcond=None)[0]
    mixing, owner = mixing_of(families)
    nu, phi, deviates = np.append(theta, 0.0), np.zeros(len(mixing)), np.zeros(mixing.shape[1])
    variance, scales = (mixing**2).sum(axis=1), np.ones(len(SOURCES))
    clean, smooth = observed, observed
    found: tuple[Problem, Fit] | None = None
    for _ in range(rounds):
        state = State(clean, smooth, nu, deviates, variance, scales)
        problem, smooth = linearised(state, families, noise, blocks)
        if found is None:
            # At first the columns hold the readings' noise: they could explain it with no noise at all.
            solved = given(problem, scales, np.ones(len(owner)))
        else:
            solved = fit(problem, (found[1].scales, found[1].spreads))
        found = (problem, solved)
        both = block_diag(np.eye(p + 1), mixing)
        estimate, covariance = both @ solved.estimate, both @ solved.covariance @ both.T
        moved = np.abs(np.append(nu, phi) - estimate) / np.sqrt(np.diag(covariance))
        nu, phi, variance = estimate[: p + 1], estimate[p + 1 :], np.diag(covariance)[p + 1 :]
        deviates, scales = solved.estimate[p + 1 :], solved.scales
        compliance = joint_compliance(families, phi, observed.joint_angles.shape[1])
        loaded = with_estimated_loads(observed, nu[:p], covariance[:p, :p], compliance)
        clean = removed(loaded, _instances(families, phi))
        if moved.max() < STANDS:
            break
    assert found is not None
    return _result(clean, families, noise, *found, used.assumed)


def _instances(families: Sequence[Family], phi: np.ndarray) -> list[EffectInstance]:
    return [
        instance for family, values in split_members(families, phi) for instance in family.instances(values)
    ]


def _result(
    clean: Observation,
    families: Sequence[Family],
    noise: Noise,
    problem: Problem,
    solved: Fit,
    assumed: str,
) -> SelfCalibration:
    p, k = problem.columns.shape[2] - 1, len(problem.kernels)
    mixing, owner = mixing_of(families)
    theta, covariance = solved.estimate[:p], solved.covariance[:p, :p]
    variance = np.diag(covariance)
    parts = np.diagonal(solved.shares, axis1=1, axis2=2)[:, :p]
    of_families = np.array([parts[2 + k :][owner == j].sum(axis=0) for j in range(len(families))])
    of_spreads = variance - np.diag(solved.conditional)[:p]
    shares = np.concatenate([parts[: 2 + k], of_families.reshape(-1, p)])
    shares = np.concatenate([shares * ((variance - of_spreads) / shares.sum(axis=0)), of_spreads[None]])
    shares = shares / variance
    # The derivative of a variance by the logarithm of a scale is twice that scale's part.
    slope = 2 * parts[2 : 2 + k]
    doubt = np.einsum("ki,kl,li->i", slope, solved.scale_covariance[:k, :k], slope)
    dof = 2 * variance**2 / np.maximum(doubt, 1e-300)
    value = mixing @ solved.estimate[p + 1 :]
    known = np.diag(mixing @ solved.conditional[p + 1 :, p + 1 :] @ mixing.T)
    sd = np.sqrt(np.diag(mixing @ solved.covariance[p + 1 :, p + 1 :] @ mixing.T))
    out, first = [], 0
    for j, family in enumerate(families):
        where, mine = slice(first, first + len(family)), np.flatnonzero(owner == j)
        first = where.stop
        moments = np.array([(part[0] ** 2).sum() for part in family.parts])
        each = moments * solved.spreads[mine] ** 2  # parts of the members' variance
        spread = float(np.sqrt(each.sum()) / family.tolerance)
        weight = each / each.sum()
        log_sd = np.sqrt(weight @ solved.scale_covariance[k + mine][:, k + mine] @ weight)
        ends = spread * np.exp(HALF_95 * np.array([-1.0, 1.0]) * log_sd)
        out.append(
            CalibratedFamily(
                family=family,
                spread=spread,
                spread95=(float(ends[0]), float(ends[1])),
                value=value[where],
                standard_error=sd[where],
                interval95=_intervals(value[where], sd[where], family.positive),
                determined=known[where] < PRIOR_ONLY * each.sum(),
            )
        )
    return SelfCalibration(
        observed=clean,
        theta=theta,
        covariance=covariance,
        sources=("weighing", "contacts", *SOURCES, *(f.name for f in families), "spreads"),
        shares=shares,
        interval_dof=np.minimum(dof, 2 * len(clean) - p),
        families=tuple(out),
        noise=scaled_noise(noise, solved.scales),
        problem=problem,
        solved=solved,
        assumed=assumed,
    )


def _intervals(value: np.ndarray, sd: np.ndarray, positive: bool) -> np.ndarray:
    """Return 95 % intervals of normal deviates, (n, 2); of positive ones the shortest intervals.

    A positive number has a normal distribution cut at zero. Its shortest interval begins at zero unless the
    density there is below that at the upper end.
    """
    if not positive:
        return value[:, None] + sd[:, None] * HALF_95 * np.array([-1.0, 1.0])
    mass = ndtr(value / sd)
    half = ndtri(0.5 + 0.475 * mass)
    low, high = value - half * sd, value + half * sd
    upper = value + sd * ndtri(1 - 0.05 * mass)
    return np.column_stack([np.maximum(low, 0.0), np.where(low < 0, upper, high)])
