"""The residuals of an experiment, linear about an estimate of base parameters, members and noise.

Compliances need care: their loads come from the cells and from where the plates stand. The noise of both
enters the residuals through the compliances that were removed, and it enters the compliances' columns.
Columns are taken at readings whose noise is removed as far as the residuals show it, given the compliances;
what remains would draw the compliances towards zero, and the information is corrected for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.calibration.families import Family
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.linear_model import nuisances, weighed_precision, without_noise
from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.member_columns import member_columns
from tulip_testbed.effects.instance import OF_LOADS
from tulip_testbed.identification.inertial_wrench import acceleration_sd, by_accelerations
from tulip_testbed.identification.joint_loads import UNSEEN
from tulip_testbed.identification.load_rates import PLATES, load_rates, soles_by_wrench
from tulip_testbed.identification.noise_in_time import WHITE, Decorrelation
from tulip_testbed.identification.noise_structure import NoiseStructure, Weights, groups
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ROWS,
    SIZE,
    by_weight,
    constants_of_stances,
    difference,
    fields,
    has_direction,
    more_as_read,
    residuals,
    residuals_in_use,
    sensitivity,
)
from tulip_testbed.identification.residual_noise import Noise, floor
from tulip_testbed.identification.variance_components import MARK_PRIOR, NO_PRIOR, SHEET_PRIOR
from tulip_testbed.measurements.data import feet_in_contact

INTERNAL = "internal forces"
SQUEEZE = "squeeze between the feet"  # the part of the internal forces that a placement's postures share
FOOT_TILT = "tilt of the feet"  # another in every row, which the direction of the force shows
INERTIA = "inertial forces"  # of a robot that moves, by CAD's inertias and measured accelerations
LOOSE = "loose parts"  # where they rest in their play, as far as the readings do not show it
ROW_TILT = np.radians(0.2)  # one s.d. at scale 1, assumed
# Friction at rest opposes the loads, in like postures alike: its wrench is no noise that averages out, and
# counts as so many times larger. On development seeds 96 % of the 95 % intervals of members held with 5,
# 94 % with 3, 91 % with an estimated scale. Friction of a robot that moves turns round with it, and is known
# in part: in a simulated motion 0.6 N, 0.7 N and 0.1 Nm are left for some seconds. Counted five times, noise
# seemed to last half a minute, since only then do like rows differ so little.
SYSTEMATIC = 5.0
INTERNAL_PRIOR = 0.01  # s.d. of the logarithm of the scale of the unseen wrench: it is not estimated
# A foot is put down not quite where the servos want it, and the closed legs push it as long as it stands. How
# far off is assumed [m, m, rad], so its scale is estimated, with a factor of two as s.d.
PUT_DOWN, SQUEEZE_PRIOR = np.array([0.002, 0.002, 0.004]), 0.7
# How well the load of a loose part is known is assumed too, so this scale is estimated.
LOOSE_PRIOR = 0.7
CHANNELS = "AFTC"
Families = Sequence[Family | FreeEffect]
# With CAD as prior data say too little of how wide a family is, but of this one.
OF_CONTACTS = ("foot-compliance", "foot-damping")


def unseen_wrench(observed: Observation) -> np.ndarray:
    """Return the s.d. of the wrench between the feet that no reading shows, (3,) [N, N, Nm]."""
    return UNSEEN * (1.0 if observed.moves else SYSTEMATIC)


def own_sources(observed: Observation) -> tuple[str, ...]:
    """Name the sources of noise that differ from row to row."""
    tilt = (FOOT_TILT,) if has_direction(observed) else ()
    inertia = (INERTIA,) if observed.moves else ()
    return ("encoders", "cells", INTERNAL, *tilt, *inertia, LOOSE)


def sources_of(observed: Observation) -> tuple[str, ...]:
    """Name all sources of noise whose scale is estimated."""
    return (*own_sources(observed), SQUEEZE, "right plate", "left plate")


@dataclass(frozen=True)
class LinearisationPoint:
    """An estimate about which the residuals are linearised.

    Attributes:
        clean: readings without the members. smooth: the same without noise, by the last linearisation.
        nu: base parameters [m] and error of the weight [N], (p + 1,).
        deviates: of the members' parts, (k,). variance: of the members, (q,). scales: of `sources_of`.
        covariance: that of another linearisation, whose unseen wrench counts; None: that of these members.
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
        reach: derivative of the residuals by the readings, through the compliances too, (m, 11, n + 2 k + 6).
        internal: change of the residuals by one s.d. of each component of the internal wrench in a row,
            (m, 11, 3). squeeze: the same by what a placement's rows share of it.
        tilt: change by one s.d. of the tilt of each foot in each row, (m, 11, 4); 0 without a direction.
        inertia: change by the inertial forces of each row, (m, 11, 1); no columns for a robot that is held.
        unsure: change by one s.d. of what the readings do not show of each effect, (m, 11, u).
        structure: of all of them, by the scales of `sources_of`.
    """

    reach: np.ndarray
    internal: np.ndarray
    squeeze: np.ndarray
    tilt: np.ndarray
    inertia: np.ndarray
    unsure: np.ndarray
    structure: NoiseStructure


@dataclass(frozen=True)
class Linearised:
    """Where the residuals were linearised, and how they change there.

    Attributes:
        smooth: readings without members and noise, at which columns are taken.
    """

    smooth: Observation
    covariance: ResidualCovariance


def linearised(
    state: LinearisationPoint, families: Families, noise: Noise
) -> tuple[LinearProblem, Linearised]:
    """Linearise the residuals about an estimate."""
    clean, theta = state.clean, state.nu[:-1]
    at, p = fields(clean), len(theta)
    mixing, owner = mixing_of(families)
    phi = mixing @ state.deviates + center_of(families)
    used = residuals_in_use(clean)[..., None]
    slope = used * sensitivity(state.smooth, theta)
    # Members at an estimate carry the noise of cells and plates, by their loads, into the residuals.
    yields = _yields(state.smooth, families)
    centers = (slice(None), ROWS["A"], at["cells"])
    as_read = more_as_read(clean, slope[centers])
    reach = slope[..., : at["plates"].stop].copy()
    reach[centers] += as_read
    reach[..., at["cells"].start :] += slope.take(yields.field, axis=2) @ (
        phi[yields.member][:, None] * yields.rate
    )
    unsure = slope @ _unsure(state.smooth, families, phi)
    if state.covariance is None:
        # The mean square: with that of an estimate that is too small, the estimate would seem too certain.
        square = np.maximum(phi, 0.0) ** 2 + state.variance
        pushed = slope.take(yields.field, axis=2) @ (
            np.sqrt(square)[yields.member][:, None] * yields.by_wrench
        )
        internal, squeeze = pushed * unseen_wrench(clean), pushed @ (state.smooth.loads.closed * PUT_DOWN)
    else:
        internal, squeeze = state.covariance.internal, state.covariance.squeeze
    feet = np.repeat(feet_in_contact(clean.measurements.support), 2, axis=1)[:, None]
    tilt = ROW_TILT * feet * slope[..., at["stance_tilt"].start : at["swing_tilt"].stop]
    tilt = tilt if has_direction(clean) else tilt[..., :0]
    motion = shaken = tilt[..., :0]
    if clean.moves:
        forces = slope[..., at["shift"].start : at["push"].stop]
        motion = forces @ clean.motion.by_cad[..., None]
        lasting = clean.noise_in_time or WHITE
        sd = clean.motion.shown * acceleration_sd(clean.measurements, noise.encoder, lasting)
        shaken = forces @ by_accelerations(state.smooth.geometry, clean.measurements) * sd[:, None]
    covariance = _covariance(reach, (internal, squeeze, tilt, motion), shaken, unsure, noise, clean)
    reach, structure = covariance.reach, covariance.structure
    if (in_time := clean.in_time) is not None:
        structure = replace(structure, shared=in_time(structure.shared), free=in_time(structure.free))
    weights = structure.weights(np.log(state.scales))

    left = residuals(clean, theta)
    left[:, ROWS["A"]] += (as_read @ (clean.cell_forces - state.smooth.cell_forces)[..., None])[..., 0]
    unexplained = left.copy()
    unexplained[:, : ROWS["T"].stop] += by_weight(clean) * (state.nu[-1] - clean.heavier)
    pull = weighted_in_time(clean, weights, used * unexplained[..., None])[..., 0]
    scaled = scaled_noise(noise, state.scales)
    smooth = without_noise(clean, pull, reach, scaled)
    at_loads = slope.take(yields.field, axis=2)
    slope = sensitivity(smooth, theta)
    base = -nuisances(smooth, CHANNELS)
    members = np.concatenate(
        [np.zeros((*left.shape, 0))]
        + [
            member_columns(smooth, theta, slope, at_sizes(f, part))
            for f, part in split_members(families, phi)
        ],
        axis=2,
    )
    there, by_sharing = _by_sharing(smooth, slope[..., at["angles"]], families, phi)
    members[..., there] += by_sharing
    cad = clean.cad
    about = np.zeros(p) if cad is None else cad.center
    output = left + base @ np.append(theta - about, clean.heavier) + members @ (phi - center_of(families))
    parts = [np.concatenate([np.zeros((len(f), 0)), *f.parts], axis=1) for f in families]
    ends = np.cumsum([0, *map(len, families)])
    split = [members[..., a:b] @ part for part, a, b in zip(parts, ends, ends[1:], strict=False)]
    members = np.concatenate([members[..., :0], *split], axis=2)

    information = np.zeros((p + 1, p + 1))
    information[-1, -1] = weighed_precision(clean) ** 2
    if cad is not None:
        information[:p, :p] = cad.precision_root.T @ cad.precision_root
    excess = np.zeros((len(phi), len(phi)))
    each = _excess(at_loads, yields.rate, reach[..., at["cells"].start :], scaled, weights, clean.in_time)
    np.add.at(excess, (yields.member[:, None], yields.member), each)
    whole = np.concatenate([base, members, output[..., None]], axis=2)
    whole *= used
    problem = LinearProblem(
        whole=whole,
        flat=p + 1,
        noise=covariance.structure,
        information=information,
        sizes=tuple(part.shape[1] for family in families for part in family.parts),
        doubt=_doubt(clean),
        excess=mixing.T @ excess @ mixing,
        about=state.deviates,
        in_time=clean.in_time,
        known=tuple(k for k, j in enumerate(owner) if _spread_is_known(families[j], cad is not None)),
    )
    return problem, Linearised(smooth, covariance)


def weighted_in_time(observed: Observation, weights: Weights, columns: np.ndarray) -> np.ndarray:
    """Return V^-1 times columns, (m, 11, n), by the weights of rows that are uncorrelated in time."""
    if (in_time := observed.in_time) is None:
        return weights(columns)
    return in_time.back(weights(in_time(columns)))


def _by_sharing(
    observed: Observation, by_angles: np.ndarray, families: Families, phi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate the residuals by the compliances of joints through the loads.

    The closed legs take load off a joint that yields, and every joint yields to its load.

    Args:
        by_angles: derivative of the residuals by the joint angles, (m, 11, n_joints).

    Returns:
        the compliances' numbers among the members, (c,), and the derivative, (m, 11, c).
    """
    joints, loads = observed.tree.joints, observed.loads
    compliance = joint_compliance(families, phi, joints)
    member = joint_compliance(families, 1 + np.arange(len(phi)), joints).astype(int) - 1
    there = np.flatnonzero(member >= 0)
    less = -loads.sharing[..., there] * loads.torques[:, None, there]
    return member[there], -(by_angles * compliance) @ less


@dataclass(frozen=True)
class _Yields:
    """Fields of `packed` that yield to the loads, and by how much per unit of a compliance.

    Attributes:
        field, member: numbers of the field and of the compliance among the members, (c,).
        rate: derivative by the readings of the contacts and six coordinates of plates, as the
            compliance is removed, (m, c, 2 k + 6).
        by_wrench: derivative by the internal wrench, (m, c, 3).
    """

    field: np.ndarray
    member: np.ndarray
    rate: np.ndarray
    by_wrench: np.ndarray


def _yields(observed: Observation, families: Families) -> _Yields:
    at, joints = fields(observed), observed.tree.joints
    torques, soles = load_rates(observed)
    width = torques.shape[2]
    torques = np.concatenate([torques, observed.loads.levers], axis=2)
    soles = np.concatenate([soles, soles_by_wrench(observed)], axis=3)
    # Load to the front turns a sole about +y, load to the left about -x.
    leans = (soles[:, :, ::-1] * np.array([[-1.0], [1.0]])).reshape(len(observed), 4, -1)
    # As a sole turns about its centre its sole point rises: that of the swing foot over the stance foot's.
    rises = leans * (observed.nominal.sole_rises * [[-1.0], [1.0]]).reshape(4, 1)
    tilts = [*range(at["stance_tilt"].start, at["swing_tilt"].stop)]
    rise = at["rise"].start
    field, member, rate = [], [], [np.zeros((len(observed), 0, torques.shape[2]))]
    for family, numbers in split_members(families, np.arange(sum(map(len, families)))):
        for k, number in enumerate(numbers.tolist()) if family.name in OF_LOADS else ():
            if family.name == "sole-compliance":
                field, member = [*field, *tilts, rise], member + [number] * (len(tilts) + 1)
                rate += [leans, rises.sum(axis=1, keepdims=True)]
            elif family.name == "foot-compliance":
                tilt = 2 * ("right", "left").index(family.targets[k // 2]) + k % 2
                field, member = [*field, tilts[tilt], rise], [*member, number, number]
                rate += [leans[:, [tilt]], rises[:, [tilt]]]
            else:
                joint = joints.index(family.targets[k])
                field, member = [*field, joint], [*member, number]
                rate.append(torques[:, [joint]])
    every = np.concatenate(rate, axis=1)
    return _Yields(np.array(field, int), np.array(member, int), every[..., :width], every[..., width:])


def yielding(observed: Observation, families: Families, phi: np.ndarray) -> np.ndarray:
    """Return what noisy readings change in the fields of `packed` as the compliances are removed.

    Returns:
        derivative, (m, k, n_joints + 2 k + 6).
    """
    at, yields = fields(observed), _yields(observed, families)
    out = np.zeros((len(observed), at["push"].stop, at["plates"].stop))
    for field, member, rate in zip(yields.field, yields.member, yields.rate.swapaxes(0, 1), strict=True):
        out[:, field, at["cells"].start :] += phi[member] * rate
    return out


def _excess(
    slope: np.ndarray,
    rate: np.ndarray,
    reach: np.ndarray,
    noise: Noise,
    weights: Weights,
    in_time: Decorrelation | None,
) -> np.ndarray:
    """Compute what the noise of cells and plates adds to the information about the compliances, (c, c).

    The columns of the compliances are taken at loads without the noise as far as the residuals show
    it. The part
    that they do not show remains: without a correction it would pass for information.

    Args:
        slope: derivative of the residuals by the fields that yield, (m, 11, c).
        rate: derivative of these by the readings of the contacts and of plates, (m, c, 2 k + 6).
        reach: derivative of the residuals by the same readings, (m, 11, 2 k + 6).
        weights: of rows that are uncorrelated in time. in_time: what makes them so. It makes the noise of
            the cells so too; the errors of plates last.
    """
    placement = weights.structure.placement
    count = rate.shape[2] - PLATES
    precision = weights.of_postures
    by_cells, by_plates = reach[..., :count], reach[..., count:]
    left = _left(np.full(count, noise.cell), by_cells.mT @ precision @ by_cells)
    spread = rate[..., :count] @ left @ rate[..., :count].mT
    out = (spread * (slope.mT @ precision @ slope)).sum(axis=0)
    # What a plate's error changes, the postures of a placement share.
    last = (lambda values: values) if in_time is None else in_time
    by_plates = last(by_plates)
    left = _left(noise.plates, placement.sums(by_plates.mT @ weights(by_plates)))[placement.number]
    m, rows, size = slope.shape
    pushed, spread = (
        (slope[:, :, None] * part.mT[:, None]).reshape(m, rows, PLATES * size)
        for part in (rate[..., count:], rate[..., count:] @ left)
    )
    pushed, spread = (part.reshape(m * rows, PLATES, size) for part in (weights(last(pushed)), last(spread)))
    return out + (pushed.transpose(1, 2, 0) @ spread.transpose(1, 0, 2)).sum(axis=0)


def _left(sd: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Return the covariance of readings whose noise is removed as the residuals show it, (g, k, k).

    Args:
        sd: of the readings, (k,). information: of the residuals about them, (g, k, k).
    """
    return np.diag(sd**2) - sd[:, None] ** 2 * information * sd**2


def _unsure(observed: Observation, families: Families, phi: np.ndarray) -> np.ndarray:
    """Return one s.d. of what the readings do not show of each effect at its present sizes, (m, k, u)."""
    out = []
    for family, sizes in split_members(families, phi):
        if not isinstance(family, FreeEffect):
            continue
        (instance,) = family.instances(sizes)
        effect, target, values = instance.effect, instance.target, instance.values
        unsure = effect.unsure(observed, target, values)
        if unsure is not None:
            predicted = effect.remove(observed, target, values)
            out.append(difference(predicted, unsure))
    return np.stack(out, axis=-1) if out else np.zeros((len(observed), fields(observed)["push"].stop, 0))


def _covariance(
    reach: np.ndarray,
    unseen: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    shaken: np.ndarray,
    unsure: np.ndarray,
    noise: Noise,
    observed: Observation,
) -> ResidualCovariance:
    at = fields(observed)
    used = residuals_in_use(observed)
    cells = noise.cell * reach[..., at["cells"]]
    angles = np.concatenate([noise.encoder * reach[..., at["angles"]], shaken], axis=2)
    tilt_and_motion = (part for part in unseen[2:] if part.shape[2])
    own = [part @ part.mT for part in (angles, cells, unseen[0], *tilt_and_motion, unsure)]
    structure = NoiseStructure(
        placement=groups(observed.measurements.placement),
        stance=groups(observed.stance),
        fixed=np.where(used[..., None], floor(noise), np.eye(SIZE)),
        own=np.stack(own),
        shared=np.concatenate([unseen[1], noise.plates * reach[..., at["plates"]]], axis=2),
        owner=len(own) + np.repeat(np.arange(3), 3),
        free=constants_of_stances(used),
    )
    return ResidualCovariance(reach, *unseen, unsure, structure)


def _doubt(observed: Observation) -> np.ndarray:
    """Return the s.d. of the logarithm of the scale of each of `sources_of`, (k,)."""
    sheet, contacts = observed.measurements.sensors, observed.measurements.contacts
    stated = sheet.cell_sd is not None if contacts is None else contacts.covariance is not None
    placed = sheet.placement_sd is not None or (observed.in_feet and not observed.moves)
    return np.array(
        [
            NO_PRIOR if sheet.encoder_sd is None else SHEET_PRIOR,
            SHEET_PRIOR if stated else NO_PRIOR,
            INTERNAL_PRIOR,
            *[NO_PRIOR] * (has_direction(observed) + observed.moves),
            LOOSE_PRIOR,
            SQUEEZE_PRIOR,
            *([MARK_PRIOR, SHEET_PRIOR] if placed else [NO_PRIOR] * 2),
        ]
    )


def _spread_is_known(family: Family | FreeEffect, by_cad: bool) -> bool:
    if isinstance(family, FreeEffect) or family.known:
        return True
    return by_cad and family.name not in OF_CONTACTS


def at_sizes(family: Family | FreeEffect, sizes: np.ndarray) -> Family | FreeEffect:
    """Return an effect at its present sizes; a family as it is."""
    return family.at(sizes) if isinstance(family, FreeEffect) else family


def split_members(families: Families, phi: np.ndarray) -> list[tuple[Family | FreeEffect, np.ndarray]]:
    ends = np.cumsum([len(family) for family in families])
    return [(f, phi[end - len(f) : end]) for f, end in zip(families, ends.tolist(), strict=True)]


def mixing_of(families: Families) -> tuple[np.ndarray, np.ndarray]:
    """Return the members from the deviates of all parts, (q, k) [SI], and the family of each part."""
    blocks = [np.concatenate(family.parts, axis=1) for family in families if family.parts]
    owner = [k for k, family in enumerate(families) for _ in family.parts]
    ends = np.cumsum([(0, 0), *(block.shape for block in blocks)], axis=0)
    out = np.zeros(ends[-1])
    for (row, column), (last_row, last_column), block in zip(ends, ends[1:], blocks, strict=False):
        out[row:last_row, column:last_column] = block
    return out, np.array(owner, int)


def center_of(families: Families) -> np.ndarray:
    """Return the means of the prior of members and sizes, (q,) [SI]."""
    return np.concatenate([np.zeros(0), *(family.center for family in families)])


def joint_compliance(families: Families, values: np.ndarray, joints: Sequence[str]) -> np.ndarray:
    """Select the compliances of the joints from all members, (n_joints,); zero where they are exact."""
    compliances = {
        joint: value
        for family, part in split_members(families, values)
        if family.name == "joint-compliance"
        for joint, value in zip(family.targets, part.tolist(), strict=True)
    }
    return np.array([compliances.get(joint, 0.0) for joint in joints])


def scaled_noise(noise: Noise, scales: np.ndarray) -> Noise:
    encoder, cell, right, left = scales[[0, 1, -2, -1]]
    plates = noise.plates * np.repeat([right, left], 3)
    return replace(noise, encoder=encoder * noise.encoder, cell=cell * noise.cell, plates=plates)
