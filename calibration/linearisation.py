"""The residuals of an experiment, linear about an estimate of base parameters, members and noise.

Compliances need care: their loads come from the cells. The cells' noise enters the residuals through the
compliances that were removed, and it enters the compliances' columns. Columns are taken at readings whose
noise is removed as far as the residuals show it, given the compliances; what remains would draw the
compliances towards zero, and the information is corrected for it.
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
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import ROWS, difference, fields, residuals, sensitivity
from tulip_testbed.identification.residual_noise import Noise, floor
from tulip_testbed.identification.variance_components import MARK_PRIOR, NO_PRIOR, SHEET_PRIOR

SOURCES = ("encoders", "cells", "right plate", "left plate", "internal forces")
# S.d. of the internal wrench of the closed legs about that of elastic servos without friction, assumed: as
# large as the wrench itself. It is not estimated, since friction at rest makes the difference no noise: it
# opposes the loads.
INTERNAL_SD = np.array([5.0, 5.0, 2.0])  # N, N, Nm
INTERNAL_PRIOR = 0.01
CHANNELS = "AFTC"
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
        fixed: part that no scale changes, (g, r, r). kernels: part of each of SOURCES, (5, g, r, r).
    """

    reach: np.ndarray
    internal: np.ndarray
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
    # Members at an estimate carry the noise of the cells, by their loads, into the residuals.
    compliances, by_cells = _by_cells(state.smooth, families)
    loaded = np.einsum("mrk,mkcq->mrcq", slope, by_cells, optimize=True)
    found = state.covariance
    if found is None:
        reach = slope[..., : at["plates"].stop].copy()
        reach[..., at["cells"]] += loaded @ phi[compliances]
        # The mean square: with that of an estimate that is too small, the estimate would seem too certain.
        square = np.maximum(phi, 0.0) ** 2 + state.variance
        yielding = np.sqrt(joint_compliance(families, square, clean.tree.joints))
        pushed = slope[..., at["angles"]] @ (yielding[:, None] * state.smooth.loads.levers)
        found = _covariance(reach, pushed * INTERNAL_SD, noise, blocks)
    fixed, kernels, reach = found.fixed, found.kernels, found.reach
    inverse = np.linalg.inv(fixed + np.tensordot(state.scales**2, kernels, axes=1))

    left = residuals(clean, theta)
    unexplained = left.copy()
    unexplained[:, ROWS["F"]] -= state.nu[-1]
    pull = blocks.back((inverse @ blocks(unexplained)[..., None])[..., 0])
    smooth = without_noise(clean, pull, reach, scaled_noise(noise, state.scales))
    slope = sensitivity(smooth, theta)
    flat = -nuisances(smooth, CHANNELS)
    flat = np.concatenate([flat[..., :p], flat[..., -1:]], axis=2)
    members = np.concatenate(
        [np.zeros((*left.shape, 0))]
        + [member_columns(smooth, theta, slope, _at(f, part)) for f, part in split_members(families, phi)],
        axis=2,
    )
    output = left + flat[..., :p] @ theta + members @ phi

    unit = 1 / np.sqrt(np.diagonal(fixed + kernels.sum(axis=0), axis1=1, axis2=2))
    both = unit[:, :, None] * unit[:, None]
    information = np.zeros((p + 1, p + 1))
    information[-1, -1] = weighing(clean)[-1] ** 2
    sd = state.scales[SOURCES.index("cells")] * noise.cell
    excess = np.zeros((len(phi), len(phi)))
    excess[np.ix_(compliances, compliances)] = _excess(
        loaded, reach[..., at["cells"]], sd, blocks.own(inverse)
    )
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


def _by_cells(observed: Observation, families: Families) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate what a unit of each compliance changes by the readings of the cells.

    The cells give the loads, which are linear in them.

    Returns:
        numbers of the compliances among the members, (c,), and derivatives, (m, k, 8, c).
    """
    q = sum(map(len, families))
    yielding = [
        (number, _unit(family, k, size), size)
        for family, numbers in split_members(families, np.arange(q))
        if family.name in OF_LOADS
        for k, (number, size) in enumerate(zip(numbers, family.steps.tolist(), strict=True))
    ]
    out = np.zeros((len(observed), fields(observed.nominal)["lift"].stop, 8, len(yielding)))
    steps = [observed.changed(cell_forces=observed.cell_forces + step) for step in np.eye(8)]
    for k, (_, one, size) in enumerate(yielding):
        predict = partial(one.effect.predict, target=one.target, values=one.values)
        plain = difference(observed, predict(observed))
        for cell, step in enumerate(steps):
            out[:, :, cell, k] = (difference(step, predict(step)) - plain) / size
    return np.array([number for number, *_ in yielding], int), out


def _excess(by_cells: np.ndarray, reach: np.ndarray, sd: float, precision: np.ndarray) -> np.ndarray:
    """Compute what the noise of the cells adds to the information about the compliances, (c, c).

    The columns of the compliances are taken at loads without the noise as far as the residuals show it. What
    they do not show remains: without a correction it would pass for information.

    Args:
        by_cells: derivative of the columns by the cells, (m, 11, 8, c).
        reach: derivative of the residuals by the cells, (m, 11, 8).
        sd: of a cell [N].
        precision: inverse covariance of each posture's residuals given the others, (m, 11, 11).
    """
    left = sd**2 * (np.eye(8) - sd**2 * reach.mT @ precision @ reach)
    weighted = np.einsum("mrs,mscq->mrcq", precision, by_cells, optimize=True)
    spread = np.einsum("mcd,mrdq->mrcq", left, by_cells, optimize=True)
    return np.tensordot(weighted, spread, axes=((0, 1, 2), (0, 1, 2)))


def _covariance(
    reach: np.ndarray, internal: np.ndarray, noise: Noise, blocks: PlacementBlocks
) -> ResidualCovariance:
    n = reach.shape[2] - 14
    fixed = blocks.covariance(np.tile(floor(noise), (len(reach), 1, 1)))
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
    return ResidualCovariance(reach, internal, fixed, np.stack(kernels))


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
