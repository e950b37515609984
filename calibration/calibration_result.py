"""The result of a self-calibration: estimates and their uncertainties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from tulip_testbed.base.result import Array, Flags, InMemory
from tulip_testbed.calibration.families import Family, tolerances_of
from tulip_testbed.calibration.family_spreads import WIDEST
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.linear_model import Background
from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.linearisation import (
    FOOT_TILT,
    INERTIA,
    INTERNAL,
    LOOSE,
    SQUEEZE,
    Families,
    Linearised,
    mixing_of,
    scaled_noise,
    sources_of,
    yielding,
)
from tulip_testbed.calibration.member_removal import members_removed
from tulip_testbed.calibration.reml import LikelihoodFit, fit, parts_of_variance
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.estimators import Unseen
from tulip_testbed.identification.load_rates import PLATES
from tulip_testbed.identification.noise_in_time import NoiseInTime
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import has_twist, moved_by, packed, unpacked
from tulip_testbed.identification.residual_noise import Noise
from tulip_testbed.identification.statistics import of_f_test, satterthwaite

HALF_95 = float(ndtri(0.975))  # half of a normal 95 % interval in s.d.
ROUNDING = 1e-6  # of a spread [tolerances]
STEADY = 3.0  # s.e. by which the last linearisation may move a number that can be believed
READINGS = 2  # the first of `sources_of`: encoders and cells
PRIOR_ONLY = 0.5  # share of its prior's variance from which a member is known by its prior only
OF_CAD = "CAD"  # what its prior leaves open, with the weighing


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
    value: Array
    standard_error: Array
    interval95: Array
    determined: Flags

    @property
    def instances(self) -> list[EffectInstance]:
        """Return the members as effects with their intervals; none is below zero that cannot be."""
        width = len(self.family.effect.parameters)
        intervals = [(low, high) for low, high in self.interval95.tolist()]
        value = np.maximum(self.value, 0.0) if self.family.positive else self.value
        return [
            replace(effect, intervals=tuple(intervals[width * k : width * (k + 1)]))
            for k, effect in enumerate(self.family.instances(value))
        ]

    @property
    def determined_instances(self) -> list[EffectInstance]:
        """Return those of which the data determine a number."""
        several = self.determined.reshape(len(self.family.targets), -1)
        return [instance for instance, known in zip(self.instances, several, strict=True) if known.any()]


@dataclass(frozen=True)
class SelfCalibration:
    """Base parameters and members of an experiment.

    A document holds the results, not what they were computed from: `observed`, `noise`, `problem`, `solved`
    and `linear` are None in a calibration that was read.

    Attributes:
        observed: the readings with all members and effects removed at their estimate.
        theta: base parameters, (p,) [m]. covariance: of theta, with everything that is uncertain, (p, p).
        sources: names of the parts of the variance. shares: parts of the variance of each parameter,
            (len(sources), p), with sum 1.
        interval_dof: degrees of freedom of each parameter's t interval, (p,). joint_dof: of the F test of
            all.
        families: with their members. effects: those that belong to no family, with 95 % intervals.
        effect_errors: s.e. of their sizes, (n,) each [SI].
        noise: with estimated scales.
        problem, solved: the linear model at the estimate. linear: where its columns were taken.
        assumed: how the tolerances were found. absent: families that were left out because they would be
            negative beyond doubt.
        moved: largest change of a number by the last linearisation, in standard errors.
        noise_in_time: of a moving record. effective_rows: of independent noise that would determine a
            constant as well as its rows. None: the rows are taken as independent.
    """

    observed: InMemory[Observation]
    theta: Array
    covariance: Array
    sources: tuple[str, ...]
    shares: Array
    interval_dof: Array
    joint_dof: float
    families: tuple[CalibratedFamily, ...]
    effects: tuple[EffectInstance, ...]
    effect_errors: tuple[Array, ...]
    noise: InMemory[Noise]
    problem: InMemory[LinearProblem]
    solved: InMemory[LikelihoodFit]
    linear: InMemory[Linearised]
    assumed: str
    moved: float
    noise_in_time: NoiseInTime | None = None
    effective_rows: float | None = None
    absent: tuple[str, ...] = ()

    @property
    def steady(self) -> bool:
        """Whether the linearisations came to rest, so that the result can be believed."""
        return self.moved < STEADY

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Return the families whose spread is the largest allowed: they would be wider if they could."""
        widest = np.exp(WIDEST) - ROUNDING
        return tuple(one.family.name for one in self.families if one.spread >= widest)

    @property
    def nu(self) -> np.ndarray:
        """Return base parameters [m] and error of the weight [N], (p + 1,)."""
        return np.append(self.theta, self.solved.estimate[len(self.theta)])

    @property
    def mixing(self) -> np.ndarray:
        """Return the members and sizes from the estimated deviates, (q, k) [SI]."""
        return mixing_of(self.all)[0]

    @property
    def all(self) -> list[Family | FreeEffect]:
        """Return the families, then the effects that belong to none."""
        return [*(c.family for c in self.families), *map(FreeEffect, self.effects)]

    def cleaned(self, observed: Observation) -> Observation:
        """Return other readings of the same laboratory with members and effects removed."""
        values = [calibrated.value for calibrated in self.families]
        phi = np.concatenate([np.zeros(0), *values, *(free.sizes for free in map(FreeEffect, self.effects))])
        weighed = observed.weighing(self.observed.heavier)
        return members_removed(weighed, self.all, phi, self.theta, self.covariance)

    def without_members(self, observed: Observation) -> Observation:
        """Return the readings with the members of all families removed; the effects are left in them."""
        families = [calibrated.family for calibrated in self.families]
        phi = np.concatenate([np.zeros(0), *(calibrated.value for calibrated in self.families)])
        # Members are those of the cells themselves. An exchange is put back by another one, the last first.
        exchanged = [one for one in self.effects if one.effect.exchanges]
        observed = removed(observed, exchanged)
        plain = members_removed(observed, families, phi, self.theta, self.covariance)
        others = [one for one in self.effects if one not in exchanged]
        if not others:
            return removed(plain, exchanged[::-1])
        # Members are removed from readings that have no effects any more, and the effects are put back:
        # a large effect and the removal of a member are not additive. What an effect changes is taken from
        # readings without members, since it is removed from such; at first members are removed alone.
        clean = replace(self, effects=tuple(others)).cleaned(observed).weighing(observed.heavier)
        out = replace(plain, standard=clean.standard, servo_stiffness=clean.servo_stiffness)
        for _ in range(2):
            out = unpacked(out, packed(moved_by(clean, removed(out, others), out)))
        return removed(out, exchanged[::-1])

    def log_evidence_about(self, start: SelfCalibration) -> float:
        """Return ln of the evidence, to be compared with that of other estimates about the same start.

        Errors in variables: a row's true readings are unknowns of its own, which no prior holds. Integrated
        out, they leave the determinant of how the readings' noise enters the residuals, as if it were
        evidence against a compliance that lets more of it in, and for a smaller unit of the readings. The
        sizes at which it is largest are not those that are estimated; those of the quadratic form are
        (Fuller 1987, "Measurement error models"). So the noise of angles, cells and plates has the
        determinant that it has at the start.
        """
        if start is self:
            return self.solved.log_evidence
        at_start, here, scales = start.problem.noise, self.problem.noise, np.log(self.solved.scales)
        reference = replace(
            here,
            own=np.concatenate([at_start.own[:READINGS], here.own[READINGS:]]),
            shared=np.concatenate([here.shared[..., :-PLATES], at_start.shared[..., -PLATES:]], axis=2),
        )
        own, about = (one.weights(scales).log_volume for one in (here, reference))
        return self.solved.log_evidence + own - about

    def background(self, most: float = np.inf) -> Background:
        """Return what is still uncertain about the members.

        Args:
            most: largest spread that is believed, in tolerances.
        """
        families = [calibrated.family for calibrated in self.families]
        _, owner = mixing_of(families)
        width = [part.shape[1] for family in families for part in family.parts]
        spreads = np.repeat(np.minimum(self.solved.spreads[: len(owner)], most), width)
        deviates = self.solved.estimate[len(self.theta) + 1 :][: len(spreads)]
        covariance = self.linear.covariance
        scales = dict(zip(sources_of(self.observed), self.solved.scales.tolist(), strict=True))
        every = (
            (INTERNAL, covariance.internal),
            (FOOT_TILT, covariance.tilt),
            (INERTIA, covariance.inertia),
            (LOOSE, covariance.unsure),
        )
        unseen = np.concatenate([scales.get(name, 0.0) * columns for name, columns in every], axis=2)
        phi = np.concatenate([np.zeros(0), *(calibrated.value for calibrated in self.families)])
        return Background(
            columns=self.problem.members[..., : len(spreads)] * spreads,
            removed=deviates / spreads,
            internal=unseen,
            squeeze=scales[SQUEEZE] * covariance.squeeze,
            yielding=yielding(self.linear.smooth, families, phi),
        )

    @property
    def mass(self) -> tuple[float, float]:
        """Return the robot's mass and its standard error, with everything that is uncertain [kg]."""
        measured, p = self.observed.measurements, len(self.theta)
        error = float(np.sqrt(self.solved.covariance[p, p]))
        weight = self.observed.weight - self.observed.heavier + float(self.solved.estimate[p])
        if measured.contacts is not None and self.observed.cad is not None and measured.weighed_mass is None:
            # The sensors' gain is no family then: it and the weight are one.
            gain = tolerances_of(measured.sensors, measured.tolerances).value.get("wrench-gain", 0.0)
            error = float(np.hypot(error, gain * weight))
        return weight / measured.gravity, error / measured.gravity

    @property
    def unseen(self) -> Unseen:
        """Return the members that are known by their prior only."""
        p = len(self.theta)
        determined = np.concatenate([np.zeros(0, bool), *(each.determined for each in self.families)])
        labels = [label for calibrated in self.families for label in calibrated.family.labels]
        value = np.concatenate([np.zeros(0), *(calibrated.value for calibrated in self.families)])
        chosen = np.flatnonzero(~determined)
        both = block_diag(np.eye(p + 1), self.mixing)[np.append(np.arange(p), p + 1 + chosen)]
        joint = both @ self.solved.covariance @ both.T
        carry = np.linalg.solve(joint[p:, p:], joint[p:, :p]).T
        return Unseen(
            labels=tuple(labels[k] for k in chosen),
            value=value[chosen],
            carry=carry,
            covariance=self.covariance - carry @ joint[p:, :p],
        )

    @property
    def data_covariance(self) -> np.ndarray:
        """Return the covariance of theta if the members known by their prior only were known, (p, p).

        It says what the postures can distinguish; `covariance` says how far the estimate can be trusted.
        """
        return self.unseen.covariance

    def keep(self, columns: Sequence[int]) -> SelfCalibration:
        """Return the estimate of a model with some of the base parameters, the others being zero.

        Args:
            columns: indices of the parameters, (k,).
        """
        p = len(self.theta)
        chosen = [*columns, p]
        problem = replace(
            self.problem,
            whole=self.problem.whole[..., [*columns, *range(p, self.problem.whole.shape[2])]],
            flat=len(chosen),
            information=self.problem.information[np.ix_(chosen, chosen)],
        )
        solved = fit(problem, (self.solved.scales, self.solved.spreads))
        linear, assumed = self.linear, self.assumed
        return result_of(
            self.observed, self.all, self.noise, problem, linear, solved, assumed, self.moved, self.absent
        )


def result_of(
    clean: Observation,
    families: Families,
    noise: Noise,
    problem: LinearProblem,
    linear: Linearised,
    solved: LikelihoodFit,
    assumed: str,
    moved: float,
    absent: tuple[str, ...],
) -> SelfCalibration:
    p, k = problem.flat - 1, len(problem.noise)
    mixing, owner = mixing_of(families)
    theta, covariance = solved.estimate[:p], solved.covariance[:p, :p]
    if clean.cad is not None:
        theta = theta + clean.cad.center
    variance = np.diag(covariance)
    each_part = parts_of_variance(problem, solved)[:, :p, :p]
    parts = np.diagonal(each_part, axis1=1, axis2=2)
    of_families = np.array([parts[2 + k :][owner == j].sum(axis=0) for j in range(len(families))])
    of_spreads = variance - np.diag(solved.conditional)[:p]
    shares = np.concatenate([parts[: 2 + k], of_families.reshape(-1, p)])
    shares = np.concatenate([shares * ((variance - of_spreads) / shares.sum(axis=0)), of_spreads[None]])
    shares = shares / variance
    # The derivative of a variance by the logarithm of a scale is twice that scale's part.
    slopes = 2 * each_part[2 : 2 + k]
    scales, most = solved.scale_covariance[:k, :k], 2 * len(clean) - p
    value = mixing @ solved.estimate[p + 1 :]
    known = np.diag(mixing @ solved.conditional[p + 1 :, p + 1 :] @ mixing.T)
    sd = np.sqrt(np.diag(mixing @ solved.covariance[p + 1 :, p + 1 :] @ mixing.T))
    out, effects, errors, first, tails = [], [], [], 0, 0.0
    for j, family in enumerate(families):
        where, mine = slice(first, first + len(family)), np.flatnonzero(owner == j)
        first = where.stop
        if isinstance(family, FreeEffect):
            tails += family.log_tail
            effects.append(_with_intervals(family, value[where], sd[where]))
            errors.append(sd[where])
            continue
        moments = np.array([(part**2).sum(axis=1) for part in family.parts])
        center = family.center
        every = moments * solved.spreads[mine, None] ** 2  # parts of the members' variance
        each = every[:, 0]
        spread = float(np.sqrt(each.sum()) / family.sizes[0])
        weight = each / each.sum()
        log_sd = np.sqrt(weight @ solved.scale_covariance[k + mine][:, k + mine] @ weight)
        ends = spread * np.exp(HALF_95 * np.array([-1.0, 1.0]) * log_sd)
        out.append(
            CalibratedFamily(
                family=replace(family, about=()),
                spread=spread,
                spread95=(float(ends[0]), float(ends[1])),
                value=value[where],
                standard_error=sd[where],
                interval95=_intervals(value[where] + center, sd[where], family.positive) - center[:, None],
                determined=known[where] < PRIOR_ONLY * every.sum(axis=0),
            )
        )
    return SelfCalibration(
        observed=clean,
        theta=theta,
        covariance=covariance,
        sources=(
            "weighing" if clean.cad is None else OF_CAD,
            "contacts",
            *_named(clean),
            *map(_source, families),
            "spreads",
        ),
        shares=shares,
        interval_dof=satterthwaite(variance, np.diagonal(slopes, axis1=1, axis2=2), scales, most),
        joint_dof=of_f_test(covariance, slopes, scales, most),
        families=tuple(out),
        effects=tuple(effects),
        effect_errors=tuple(errors),
        noise=scaled_noise(noise, solved.scales),
        problem=problem,
        solved=replace(solved, log_evidence=solved.log_evidence + tails),
        linear=linear,
        assumed=assumed,
        moved=moved,
        noise_in_time=clean.noise_in_time,
        effective_rows=None if clean.in_time is None else clean.in_time.effective_rows,
        absent=absent,
    )


def _named(observed: Observation) -> list[str]:
    """Return `sources_of` in words that fit the contact sensors."""
    words = {} if has_twist(observed) else {"cells": "contact sensors"}
    if observed.in_feet:
        words |= {f"{side} plate": f"{side} foot's place" for side in ("right", "left")}
    return [words.get(name, name) for name in sources_of(observed)]


def _source(family: Family | FreeEffect) -> str:
    return family.start.label if isinstance(family, FreeEffect) else family.name


def _with_intervals(free: FreeEffect, sizes: np.ndarray, sd: np.ndarray) -> EffectInstance:
    """Return an effect at its estimate with the 95 % intervals of its sizes."""
    (instance,) = free.instances(sizes)
    intervals: list[tuple[float, float] | None] = [None] * len(instance.values)
    for k, number in enumerate(free.effect.sizes):
        positive = free.effect.parameters[number].positive
        low, high = _intervals(sizes[[k]], sd[[k]], positive)[0].tolist()
        intervals[number] = (low, high)
    return replace(instance, intervals=tuple(intervals))


def _intervals(value: np.ndarray, sd: np.ndarray, positive: bool) -> np.ndarray:
    """Return 95 % intervals of normal deviates, (n, 2); of positive ones the shortest intervals.

    A positive number has a normal distribution cut at zero. Its shortest interval begins at zero unless the
    density there is below that at the upper end. An estimate below zero, which other errors can make, tells
    no more than one at zero (Cowan et al. 2011, power-constrained limits).
    """
    if not positive:
        return value[:, None] + sd[:, None] * HALF_95 * np.array([-1.0, 1.0])
    value = np.maximum(value, 0.0)
    mass = ndtr(value / sd)
    half = ndtri(0.5 + 0.475 * mass)
    low, high = value - half * sd, value + half * sd
    upper = value + sd * ndtri(1 - 0.05 * mass)
    return np.column_stack([np.maximum(low, 0.0), np.where(low < 0, upper, high)])
