"""The residuals of an experiment, linear about an estimate of base parameters, members and noise.

Compliances need care: their loads come from the cells and from where the plates stand. The noise of both
enters the residuals through the compliances that were removed, and it enters the compliances' columns.
Columns are taken at readings whose noise is removed as far as the residuals show it, given the compliances;
what remains would draw the compliances towards zero, and the information is corrected for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from tulip_testbed.calibration.families import Family
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.linear_model import nuisances, weighing, without_noise
from tulip_testbed.calibration.member_columns import member_columns
from tulip_testbed.calibration.placement_blocks import PlacementBlocks
from tulip_testbed.calibration.reml import Problem
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.joint_loads import UNSEEN
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import ROWS, difference, fields, residuals, sensitivity
from tulip_testbed.identification.residual_noise import Noise, floor
from tulip_testbed.identification.variance_components import MARK_PRIOR, NO_PRIOR, SHEET_PRIOR

SOURCES = ("encoders", "cells", "right plate", "left plate", "internal forces")
# Friction at rest opposes the loads, in like postures alike: its wrench is no noise that averages out, and
# counts as so many times larger. On development seeds 96 % of the 95 % intervals of members held with 5,
# 94 % with 3, 91 % with an estimated scale.
SYSTEMATIC = 5.0
INTERNAL_PRIOR = 0.01  # s.d. of the logarithm of the scale of the unseen wrench: it is not estimated
CHANNELS = "AFTC"
PLATE_STEP, COMPLIANCE_STEP = 1e-4, 1e-6  # of difference quotients [m, rad], [rad/Nm]
Families = Sequence[Family | FreeEffect]
OF_LOADS = ("joint-compliance", "sole-compliance")


@dataclass(frozen=True)
class State:
    """An estimate about which the residuals are linearised.

    Attributes:
        clean: readings without the members. smooth: the same without noise, by the last linearisation.
        nu: base parameters [m] and error of the weight [N], (p + 1,).
        deviates: of the members' parts, (k,). variance: of the members, (q,). scales: of SOURCES.
        covariance: that of another linearisation, in place of the one at these members; None: at these.
    """

    clean: Observation
    smooth: Observation
    nu: np.ndarray
    deviates: np.ndarray
    variance: np.ndarray
    scales: np.ndarray
    covariance: ResidualCovariance | None


@dataclass(frozen=True)
class ResidualCovariance:
    """Covariance of the residuals by the data sheets.

    Attributes:
        reach: derivative of the residuals by the readings, through the compliances too, (m, 11, n + 14).
        internal: change of the residuals by one s.d. of each component of the internal wrench, (m, 11, 3).
        unsure: change by one s.d. of what the readings do not show of each effect, (m, 11, u).
        fixed: part that no scale changes, (g, r, r). kernels: part of each of SOURCES, (5, g, r, r).
    """

    reach: np.ndarray
    internal: np.ndarray
    unsure: np.ndarray
    fixed: np.ndarray
    kernels: np.ndarray


@dataclass(frozen=True)
class Linearised:
    """Where the residuals were linearised, and how they change there.

    Attributes:
        smooth: readings without members and noise, at which columns are taken.
        members: derivative of the residuals by the members, (m, 11, q).
        unit: factor by which each row of the problem is scaled, (g, r) [1/SI].
    """

    smooth: Observation
    members: np.ndarray
    unit: np.ndarray
    covariance: ResidualCovariance


def linearised(
    state: State, families: Families, noise: Noise, blocks: PlacementBlocks
) -> tuple[Problem, Linearised]:
    """Linearise the residuals about an estimate, each row divided by its s.d. by the data sheets."""
    clean, theta = state.clean, state.nu[:-1]
    at, p = fields(clean.nominal), len(theta)
    mixing, owner = mixing_of(families)
    phi = mixing @ state.deviates
    slope = sensitivity(state.smooth, theta)
    # Members at an estimate carry the noise of cells and plates, by their loads, into the residuals.
    compliances, loaded = _by_loads(state.smooth, slope, families)
    found = state.covariance
    if found is None:
        reach = slope[..., : at["plates"].stop].copy()
        reach[..., at["cells"].start :] += loaded @ phi[compliances]
        # The mean square: with that of an estimate that is too small, the estimate would seem too certain.
        square = np.maximum(phi, 0.0) ** 2 + state.variance
        yielding = np.sqrt(joint_compliance(families, square, clean.tree.joints))
        pushed = slope[..., at["angles"]] @ (yielding[:, None] * state.smooth.loads.levers)
        unsure = slope @ _unsure(state.smooth, families, phi)
        found = _covariance(reach, pushed * SYSTEMATIC * UNSEEN, unsure, noise, blocks)
    fixed, kernels, reach = found.fixed, found.kernels, found.reach
    inverse = np.linalg.inv(fixed + np.tensordot(state.scales**2, kernels, axes=1))

    left = residuals(clean, theta)
    unexplained = left.copy()
    unexplained[:, ROWS["F"]] -= state.nu[-1]
    pull = blocks.back((inverse @ blocks(unexplained)[..., None])[..., 0])
    scaled = scaled_noise(noise, state.scales)
    smooth = without_noise(clean, pull, reach, scaled)
    slope = sensitivity(smooth, theta)
    flat = -nuisances(smooth, CHANNELS)
    flat = np.concatenate([flat[..., :p], flat[..., -1:]], axis=2)
    members = np.concatenate(
        [np.zeros((*left.shape, 0))]
        + [member_columns(smooth, theta, slope, _at(f, part)) for f, part in split_members(families, phi)],
        axis=2,
    )
    members += _by_sharing(smooth, slope[..., at["angles"]], families, phi)
    output = left + flat[..., :p] @ theta + members @ phi

    unit = 1 / np.sqrt(np.diagonal(fixed + kernels.sum(axis=0), axis1=1, axis2=2))
    both = unit[:, :, None] * unit[:, None]
    information = np.zeros((p + 1, p + 1))
    information[-1, -1] = weighing(clean)[-1] ** 2
    excess = np.zeros((len(phi), len(phi)))
    excess[np.ix_(compliances, compliances)] = _excess(
        loaded[:, :, :8], reach[..., at["cells"]], np.full(8, scaled.cell), blocks.own(inverse)
    ) + _excess(blocks(loaded[:, :, 8:]), blocks(reach[..., at["plates"]]), scaled.plates, inverse)
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
        known=tuple(k for k, j in enumerate(owner) if isinstance(families[j], FreeEffect)),
        volume=float(np.log(unit).sum()),
    )
    return problem, Linearised(smooth, members, unit, found)


def _by_sharing(
    observed: Observation, by_angles: np.ndarray, families: Families, phi: np.ndarray
) -> np.ndarray:
    """Differentiate the residuals by the compliances through the loads, (m, 11, q).

    The closed legs take load off a joint that yields, and every joint yields to its load.

    Args:
        by_angles: derivative of the residuals by the joint angles, (m, 11, n_joints).
    """
    out = np.zeros((len(observed), by_angles.shape[1], len(phi)))
    joints = observed.tree.joints
    compliance = joint_compliance(families, phi, joints)
    numbers = joint_compliance(families, 1 + np.arange(len(phi)), joints).astype(int) - 1
    for joint in np.flatnonzero((numbers >= 0) & (compliance != 0).any()):
        softer = 1 / observed.servo_stiffness
        softer[joint] += COMPLIANCE_STEP
        change = observed.changed(servo_stiffness=1 / softer).torques - observed.torques
        out[..., numbers[joint]] = -(by_angles @ (compliance * change)[..., None])[..., 0] / COMPLIANCE_STEP
    return out


def _by_loads(observed: Observation, slope: np.ndarray, families: Families) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate what a unit of each compliance changes in the residuals by readings of cells and plates.

    They give the loads, which are linear in the cells.

    Args:
        slope: derivative of the residuals by the fields, (m, 11, k).

    Returns:
        numbers of the compliances among the members, (c,), and derivatives by eight cells and the poses of
        two plates, (m, 11, 14, c).
    """
    q = sum(map(len, families))
    yielding = [
        (number, _unit(family, k, size), size)
        for family, numbers in split_members(families, np.arange(q))
        if family.name in OF_LOADS
        for k, (number, size) in enumerate(zip(numbers, family.steps.tolist(), strict=True))
    ]
    out = np.zeros((len(observed), slope.shape[1], 14, len(yielding)))
    moved = [observed.changed(cell_forces=observed.cell_forces + step) for step in np.eye(8)]
    moved += [
        observed.changed(plate_poses=observed.plate_poses + step.reshape(2, 3))
        for step in PLATE_STEP * np.eye(6)
    ]
    steps = np.repeat([1.0, PLATE_STEP], [8, 6])
    for k, (_, one, size) in enumerate(yielding):
        predict = partial(one.effect.predict, target=one.target, values=one.values)
        plain = difference(observed, predict(observed))
        for reading, (other, step) in enumerate(zip(moved, steps.tolist(), strict=True)):
            change = (difference(other, predict(other)) - plain) / (size * step)
            out[:, :, reading, k] = (slope @ change[..., None])[..., 0]
    return np.array([number for number, *_ in yielding], int), out


def _excess(by_readings: np.ndarray, reach: np.ndarray, sd: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Compute what the noise of some readings adds to the information about the compliances, (c, c).

    The columns of the compliances are taken at loads without the noise as far as the residuals show it. What
    they do not show remains: without a correction it would pass for information.

    Args:
        by_readings: derivative of the columns by the readings, (g, r, k, c), of each posture for cells, of
            each placement for plates.
        reach: derivative of the residuals by the readings, (g, r, k).
        sd: of the readings, (k,).
        precision: inverse covariance of the residuals, (g, r, r).
    """
    left = np.diag(sd**2) - sd[:, None] ** 2 * (reach.mT @ precision @ reach) * sd**2
    weighted = np.einsum("mrs,mscq->mrcq", precision, by_readings, optimize=True)
    spread = np.einsum("mcd,mrdq->mrcq", left, by_readings, optimize=True)
    return np.tensordot(weighted, spread, axes=((0, 1, 2), (0, 1, 2)))


def _unsure(observed: Observation, families: Families, phi: np.ndarray) -> np.ndarray:
    """Return one s.d. of what the readings do not show of each effect at its present sizes, (m, k, u)."""
    out = []
    for family, sizes in split_members(families, phi):
        unsure = family.effect.mechanism.unsure if isinstance(family, FreeEffect) else None
        if unsure is not None:
            (one,) = family.instances(sizes)
            predicted = one.effect.predict(observed, one.target, one.values)
            out.append(difference(predicted, unsure(observed, one.target, one.values)))
    return (
        np.stack(out, axis=-1) if out else np.zeros((len(observed), fields(observed.nominal)["lift"].stop, 0))
    )


def _covariance(
    reach: np.ndarray, internal: np.ndarray, unsure: np.ndarray, noise: Noise, blocks: PlacementBlocks
) -> ResidualCovariance:
    n = reach.shape[2] - 14
    fixed = blocks.covariance(floor(noise) + unsure @ unsure.mT)
    each = np.arange(fixed.shape[1])
    fixed[:, each, each] += blocks.padding
    angles, cells = noise.encoder * reach[..., :n], noise.cell * reach[..., n : n + 8]
    plates = blocks(noise.plates * reach[..., n + 8 :])
    kernels = [
        blocks.covariance(angles @ angles.mT),
        blocks.covariance(cells @ cells.mT),
        plates[..., :3] @ plates[..., :3].mT,
        plates[..., 3:] @ plates[..., 3:].mT,
        blocks.covariance(internal @ internal.mT),
    ]
    return ResidualCovariance(reach, internal, unsure, fixed, np.stack(kernels))


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


def _unit(family: Family | FreeEffect, number: int, size: float) -> EffectInstance:
    """Return the effect in which one number has this value and the others are zero."""
    if isinstance(family, FreeEffect):
        family = FreeEffect(family.instances(np.zeros(len(family)))[0])
    return family.one(number, size)


def _at(family: Family | FreeEffect, sizes: np.ndarray) -> Family | FreeEffect:
    """Return an effect at its present sizes; a family as it is."""
    return FreeEffect(family.instances(sizes)[0]) if isinstance(family, FreeEffect) else family


def split_members(families: Families, phi: np.ndarray) -> list[tuple[Family | FreeEffect, np.ndarray]]:
    ends = np.cumsum([len(family) for family in families])
    return [(f, phi[end - len(f) : end]) for f, end in zip(families, ends.tolist(), strict=True)]


def mixing_of(families: Families) -> tuple[np.ndarray, np.ndarray]:
    """Return the members from the deviates of all parts, (q, k) [SI], and the family of each part."""
    rows = [np.concatenate(family.parts, axis=1) for family in families if family.parts]
    owner = [k for k, family in enumerate(families) for _ in family.parts]
    return block_diag(*rows) if rows else np.zeros((0, 0)), np.array(owner, int)


def joint_compliance(families: Families, values: np.ndarray, joints: Sequence[str]) -> np.ndarray:
    """Select the compliances of the joints from all members, (n_joints,); zero where they are exact."""
    found = {
        joint: value
        for family, part in split_members(families, values)
        if family.name == "joint-compliance"
        for joint, value in zip(family.targets, part.tolist(), strict=True)
    }
    return np.array([found.get(joint, 0.0) for joint in joints])


def scaled_noise(noise: Noise, scales: np.ndarray) -> Noise:
    encoder, cell, right, left, _ = scales
    plates = noise.plates * np.repeat([right, left], 3)
    return replace(noise, encoder=encoder * noise.encoder, cell=cell * noise.cell, plates=plates)
