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
from functools import partial

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import norm

from tulip_testbed.calibration.estimated_loads import with_estimated_loads
from tulip_testbed.calibration.families import Family, families_of, tolerances_of
from tulip_testbed.calibration.linear_model import nuisances, weighing, without_noise
from tulip_testbed.calibration.member_columns import member_columns
from tulip_testbed.calibration.placement_blocks import PlacementBlocks, placement_blocks
from tulip_testbed.calibration.reml import Fit, Problem, fit, given
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import ROWS, difference, fields, residuals, sensitivity
from tulip_testbed.identification.residual_noise import FLOOR, Noise, noise_of
from tulip_testbed.identification.variance_components import MARK_PRIOR, NO_PRIOR, SHEET_PRIOR

ROUNDS = 12
STANDS = 0.05  # s.e. by which nothing moves any more
PRIOR_ONLY = 0.5  # share of its prior's variance from which a member is known by its prior only
SOURCES = ("encoders", "cells", "right plate", "left plate", "internal forces")
# S.d. of the internal wrench of the closed legs about that of elastic servos without friction, assumed: as
# large as the wrench itself. It is not estimated, since friction at rest makes the difference no noise: it
# opposes the loads.
INTERNAL_SD = np.array([5.0, 5.0, 2.0])  # N, N, Nm
INTERNAL_PRIOR = 0.01
CHANNELS = "AFTC"
OF_LOADS = ("joint-compliance", "sole-compliance")


@dataclass(frozen=True)
class CalibratedFamily:
    """A family and the spread of its members.

    Attributes:
        spread: estimated s.d. of the members, in tolerances. interval95: of the spread.
        label: of every number of the family. value, standard_error: (n,) [SI].
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
        intervals = [tuple(map(float, pair)) for pair in self.interval95]
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
        return _mixing([c.family for c in self.families])[0]

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


@dataclass(frozen=True)
class _State:
    """An estimate about which the residuals are linearised.

    Attributes:
        clean: readings without the members. smooth: the same without noise, by the last linearisation.
        nu: base parameters [m] and error of the weight [N], (p + 1,).
        deviates: of the members' parts, (k,). variance: of the members, (q,). scales: of SOURCES.
    """

    clean: Observation
    smooth: Observation
    nu: np.ndarray
    deviates: np.ndarray
    variance: np.ndarray
    scales: np.ndarray


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
    mixing, owner = _mixing(families)
    nu, phi, deviates = np.append(theta, 0.0), np.zeros(len(mixing)), np.zeros(mixing.shape[1])
    variance, scales = (mixing**2).sum(axis=1), np.ones(len(SOURCES))
    clean, smooth = observed, observed
    found: tuple[Problem, Fit] | None = None
    for _ in range(rounds):
        state = _State(clean, smooth, nu, deviates, variance, scales)
        problem, smooth = _linearised(state, families, noise, blocks)
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
        compliance = _compliance(families, phi, observed.joint_angles.shape[1])
        loaded = with_estimated_loads(observed, nu[:p], covariance[:p, :p], compliance)
        clean = removed(loaded, _instances(families, phi))
        if moved.max() < STANDS:
            break
    assert found is not None
    return _result(clean, families, noise, *found, used.assumed)


def _instances(families: Sequence[Family], phi: np.ndarray) -> list[EffectInstance]:
    return [instance for family, values in _split(families, phi) for instance in family.instances(values)]


def _split(families: Sequence[Family], phi: np.ndarray) -> list[tuple[Family, np.ndarray]]:
    ends = np.cumsum([len(family) for family in families])
    return [(f, phi[end - len(f) : end]) for f, end in zip(families, ends.tolist(), strict=True)]


def _mixing(families: Sequence[Family]) -> tuple[np.ndarray, np.ndarray]:
    """Return the members from the deviates of all parts, (q, k) [SI], and the family of each part."""
    rows = [np.concatenate(family.parts, axis=1) for family in families]
    owner = [k for k, family in enumerate(families) for _ in family.parts]
    return block_diag(*rows) if rows else np.zeros((0, 0)), np.array(owner, int)


def _compliance(families: Sequence[Family], values: np.ndarray, joints: int) -> np.ndarray:
    """Select the compliances of the joints from all members, (n_joints,); zeros if they are exact."""
    found = [part for family, part in _split(families, values) if family.name == "joint-compliance"]
    return found[0] if found else np.zeros(joints)


def _scaled(noise: Noise, scales: np.ndarray) -> Noise:
    encoder, cell, right, left, _ = scales
    plates = noise.plates * np.repeat([right, left], 3)
    return replace(noise, encoder=encoder * noise.encoder, cell=cell * noise.cell, plates=plates)


def _linearised(
    state: _State, families: Sequence[Family], noise: Noise, blocks: PlacementBlocks
) -> tuple[Problem, Observation]:
    """Linearise the residuals about an estimate, each row divided by its s.d. by the data sheets.

    Returns:
        the problem, and the readings without members and noise, at which its columns are taken.
    """
    clean, theta = state.clean, state.nu[:-1]
    at, p = fields(clean.nominal), len(theta)
    mixing, _ = _mixing(families)
    phi = mixing @ state.deviates
    slope = sensitivity(state.smooth, theta)
    reach = slope[..., : at["plates"].stop].copy()
    # Members at an estimate carry the noise of the cells, by their loads, into the residuals.
    loaded = np.einsum("mrk,mkcq->mrcq", slope, _by_cells(state.smooth, families), optimize=True)
    reach[..., at["cells"]] += loaded @ phi
    # The mean square: with that of an estimate that is too small, the estimate would seem too certain.
    square = np.maximum(phi, 0.0) ** 2 + state.variance
    yielding = np.sqrt(_compliance(families, square, at["angles"].stop))
    pushed = slope[..., at["angles"]] @ (yielding[:, None] * state.smooth.loads.levers)
    kernels = _kernels(reach, pushed, noise, blocks)
    fixed = blocks.covariance(np.tile(np.diag(FLOOR**2), (len(clean), 1, 1)))
    each = np.arange(fixed.shape[1])
    fixed[:, each, each] += blocks.padding
    inverse = np.linalg.inv(fixed + np.tensordot(state.scales**2, kernels, axes=1))

    left = residuals(clean, theta)
    unexplained = left.copy()
    unexplained[:, ROWS["F"]] -= state.nu[-1]
    pull = blocks.back((inverse @ blocks(unexplained)[..., None])[..., 0])
    smooth = without_noise(clean, pull, reach, _scaled(noise, state.scales))
    slope = sensitivity(smooth, theta)
    flat = -nuisances(smooth, CHANNELS)
    flat = np.concatenate([flat[..., :p], flat[..., -1:]], axis=2)
    members = member_columns(smooth, theta, slope, families)
    output = left + flat[..., :p] @ theta + members @ phi

    unit = 1 / np.sqrt(np.diagonal(fixed + kernels.sum(axis=0), axis1=1, axis2=2))
    both = unit[:, :, None] * unit[:, None]
    information = np.zeros((p + 1, p + 1))
    information[-1, -1] = weighing(clean)[-1] ** 2
    sd = state.scales[SOURCES.index("cells")] * noise.cell
    excess = _excess(loaded, reach[..., at["cells"]], sd, blocks.own(inverse))
    problem = Problem(
        output=unit * blocks(output),
        columns=unit[..., None] * blocks(flat),
        members=unit[..., None] * (blocks(members) @ mixing),
        fixed=both * fixed,
        kernels=both * kernels,
        information=information,
        roots=tuple(np.eye(part.shape[1]) for family in families for part in family.parts),
        doubt=_doubt(clean),
        excess=mixing.T @ excess @ mixing,
        about=state.deviates,
    )
    return problem, smooth


def _by_cells(observed: Observation, families: Sequence[Family]) -> np.ndarray:
    """Differentiate what a unit of each member changes by the readings of the cells, (m, k, 8, q).

    Only compliances depend on the cells, which give their loads. The loads are linear in the cells.
    """
    width = fields(observed.nominal)["lift"].stop
    out = np.zeros((len(observed), width, 8, sum(map(len, families))))
    steps = [observed.changed(cell_forces=observed.cell_forces + step) for step in np.eye(8)]
    for family, where in _split(families, np.arange(out.shape[3])):
        if family.name in OF_LOADS:
            unit = family.instances(np.full(len(family), family.tolerance))
            for k, one in zip(where, unit, strict=True):
                predict = partial(one.effect.predict, target=one.target, values=one.values)
                plain = difference(observed, predict(observed))
                for cell, step in enumerate(steps):
                    change = difference(step, predict(step)) - plain
                    out[:, :, cell, k] = change / family.tolerance
    return out


def _excess(by_cells: np.ndarray, reach: np.ndarray, sd: float, precision: np.ndarray) -> np.ndarray:
    """Compute what the noise of the cells adds to the information about the members, (q, q).

    The columns of the compliances are taken at loads without the noise as far as the residuals show it. What
    they do not show remains: without a correction it would pass for information.

    Args:
        by_cells: derivative of the columns by the cells, (m, 11, 8, q).
        reach: derivative of the residuals by the cells, (m, 11, 8).
        sd: of a cell [N].
        precision: inverse covariance of each posture's residuals given the others, (m, 11, 11).
    """
    left = sd**2 * (np.eye(8) - sd**2 * reach.mT @ precision @ reach)
    weighted = np.einsum("mrs,mscq->mrcq", precision, by_cells, optimize=True)
    spread = np.einsum("mcd,mrdq->mrcq", left, by_cells, optimize=True)
    return np.tensordot(weighted, spread, axes=((0, 1, 2), (0, 1, 2)))


def _kernels(reach: np.ndarray, pushed: np.ndarray, noise: Noise, blocks: PlacementBlocks) -> np.ndarray:
    """Return the covariance that each of SOURCES gives by the data sheets, (5, g, r, r).

    Args:
        pushed: derivative of the residuals by the internal wrench, (m, 11, 3).
    """
    pushed = pushed * INTERNAL_SD
    n = reach.shape[2] - 14
    angles, cells = noise.encoder * reach[..., :n], noise.cell * reach[..., n : n + 8]
    plates = blocks(noise.plates * reach[..., n + 8 :])
    return np.stack(
        [
            blocks.covariance(angles @ angles.mT),
            blocks.covariance(cells @ cells.mT),
            plates[..., :3] @ plates[..., :3].mT,
            plates[..., 3:] @ plates[..., 3:].mT,
            blocks.covariance(pushed @ pushed.mT),
        ]
    )


def _doubt(observed: Observation) -> np.ndarray:
    """Return the s.d. of the logarithm of the scale of each of SOURCES, (5,)."""
    sheet = observed.measurements.sensors
    return np.array(
        [
            NO_PRIOR if sheet.encoder_sd is None else SHEET_PRIOR,
            NO_PRIOR if sheet.cell_sd is None else SHEET_PRIOR,
            *([NO_PRIOR] * 2 if sheet.placement_sd is None else [MARK_PRIOR, SHEET_PRIOR]),
            INTERNAL_PRIOR,
        ]
    )


def _result(
    clean: Observation,
    families: Sequence[Family],
    noise: Noise,
    problem: Problem,
    solved: Fit,
    assumed: str,
) -> SelfCalibration:
    p, k = problem.columns.shape[2] - 1, len(problem.kernels)
    mixing, owner = _mixing(families)
    theta, covariance = solved.estimate[:p], solved.covariance[:p, :p]
    variance = np.diag(covariance)
    parts = np.diagonal(solved.shares, axis1=1, axis2=2)[:, :p]
    of_families = np.array([parts[2 + k :][owner == j].sum(axis=0) for j in range(len(families))])
    of_spreads = variance - np.diag(solved.conditional)[:p]
    shares = np.concatenate([parts[: 2 + k], of_families.reshape(-1, p), of_spreads[None]]) / variance
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
        moments = [(part[0] ** 2).sum() for part in family.parts]
        each = moments * solved.spreads[mine] ** 2  # parts of the members' variance
        spread = float(np.sqrt(each.sum()) / family.tolerance)
        weight = each / each.sum()
        log_sd = np.sqrt(weight @ solved.scale_covariance[k + mine][:, k + mine] @ weight)
        ends = spread * np.exp(norm.ppf([0.025, 0.975]) * log_sd)
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
        noise=_scaled(noise, solved.scales),
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
        return value[:, None] + sd[:, None] * norm.ppf([0.025, 0.975])
    mass = norm.cdf(value / sd)
    half = norm.ppf(0.5 + 0.475 * mass)
    low, high = value - half * sd, value + half * sd
    upper = value + sd * norm.isf(0.05 * mass)
    return np.column_stack([np.maximum(low, 0.0), np.where(low < 0, upper, high)])
