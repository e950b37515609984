"""The wrench of the ground that the nominal robot needs to hold a posture, or to move as it was measured."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Self

import mujoco
import numpy as np

from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.kinematics import frame_positions, link_rotations, roll_pitch_yaw, walk
from tulip_testbed.identification.noise_in_time import NoiseInTime
from tulip_testbed.identification.nominal import Nominal, PostureGeometry
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.robot import rotation_matrices

INERTIA_SD = 0.3  # relative, of the second moments of a link's density about its centre; assumed
ROCKED = 0.01  # rad/s, rad/s2: steps of derivatives
SYMMETRIC = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])  # elements xx, xy, yy, xz, yz, zz
INSTANT = 0.001  # s, step of differences in time
LATER = 0.02  # s, the same of the loads, which readings give
# Variance of a row's acceleration and jerk by that of a sample, times samples and half window^4 or ^6; of its
# acceleration by the intensity [rad2/s] of a random walk, times half window^3. By the weights of
# `series_reduction`.
ACCELERATION_NOISE, JERK_NOISE, OF_A_WALK = 45.0, 1575.0, 15 / 7
LENGTH = 1.0  # m: a force counts as a shift of the centre of pressure by it over the weight
MOST_DIRECTIONS, LEAST_SHIFT = 12, 1e-5  # of inertial parameters that the base parameters leave open; m
CROSSES = np.cross(np.eye(3)[:, None], np.eye(3)).mT.reshape(3, 9)  # e_i x, side by side
# Gauss's rule for means over a row's window, whose weight is 15/16 (1 - u^2)^2: places u and weights.
QUADRATURE = ((-(3**-0.5), 3 / 14), (0.0, 4 / 7), (3**-0.5, 3 / 14))


def link_wrenches(nominal: Nominal, measurements: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Compute what each link needs, (m, n_links, 6) [N, Nm], and its centre of mass, (m, n_links, 3) [m].

    The sum over the links is the wrench of the ground, in double support on both feet, in the base frame. The
    base foot is flat and at rest, and moments are about its sole point. Without rates or accelerations of the
    joints these are zero.
    """
    regressor, centers = _regressor(nominal, measurements)
    return np.einsum("mlik,lk->mli", regressor, inertial_parameters(nominal.robot.model)), centers


def wrench_regressor(nominal: Nominal, measurements: Measurements) -> np.ndarray:
    """Compute the regressor of the sum of `link_wrenches`, (m, 6, n_links, 10), for `inertial_parameters`.

    Atkeson, An and Hollerbach 1986.
    """
    return _regressor(nominal, measurements)[0].swapaxes(1, 2)


def inertial_parameters(model: mujoco.MjModel) -> np.ndarray:
    """Return mass, first moments and inertia about the origin of each link's frame, (n_links, 10).

    The order is m, m c_x, m c_y, m c_z, xx, xy, yy, xz, yz, zz [kg, kg m, kg m2]; links as in the MJCF file.
    """
    standard = standard_parameters(model)
    principal = rotation_matrices(model.body_iquat[1:])
    about_center = principal * model.body_inertia[1:, None] @ principal.mT
    return np.column_stack([standard, moved_inertia(standard, about_center)])


def moved_inertia(standard: np.ndarray, about_center: np.ndarray) -> np.ndarray:
    """Return the elements of inertias about the origin, (n, 6), of those about the centre of mass, (n, 3, 3).

    Masses and centres are given by standard parameters, (n, 4) [kg, kg m].
    """
    mass, moment = standard[:, :1], standard[:, 1:]
    center = np.divide(moment, mass, out=np.zeros_like(moment), where=mass > 0)
    cross = _crossing(center)
    whole = about_center - mass[..., None] * cross @ cross
    return whole[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]


def rates_of(m: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Return rates and accelerations of the joints, (m, n_joints) each; zero where they were not measured."""
    none = np.zeros_like(m.joint_angles)
    rates, accelerations = (none if v is None else v for v in (m.joint_rates, m.joint_accelerations))
    return rates, accelerations


def _regressor(
    nominal: Nominal, measurements: Measurements, turning: Sequence[float] | np.ndarray = (0.0,) * 6
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the regressor, with the base foot turning at a rate and an acceleration, (6,)."""
    m, robot = measurements, nominal.robot
    rates, accelerations = rates_of(m)
    side, count = base_foot(m.support), len(nominal.parameters.tree.links)
    regressor, centers = np.empty((len(m), count, 6, 10)), np.empty((len(m), count, 3))
    for k, foot in enumerate((robot.stance_foot, robot.swing_foot)):
        rows = side == k
        motion = m.joint_angles[rows], rates[rows], accelerations[rows]
        regressor[rows], centers[rows] = _of_foot(
            nominal, foot, nominal.points[k], motion, m.gravity, turning
        )
    return regressor, centers


def _by_cad(nominal: Nominal, measurements: Measurements) -> tuple[np.ndarray, float]:
    """Return CAD's `inertial_parameters` in proportion to the weighed mass, and the weight [N]."""
    weighed = measurements.weighed_mass
    mass = weighed[0] if weighed else nominal.mass
    return mass / nominal.mass * inertial_parameters(nominal.robot.model), mass * measurements.gravity


@dataclass(frozen=True, eq=False)
class BeyondWeight:
    """Forces of motion beyond the weight: shift of the centre of pressure, vertical and horizontal force.

    The five numbers are side by side [m, m, N, -, -], the horizontal force over the weight. The centre of
    pressure is that in the plane to which the contacts' readings refer.

    Attributes:
        by_cad: by the nominal inertial parameters, (m, 5).
        slope: derivative by the base parameters, (m, 5, p) [1/m]. Of the inertial parameters that lead to
            the same base parameters it takes those that are nearest to CAD.
        unknown: change by independent deviates of s.d. 1 of what the base parameters leave open of the
            inertial parameters, (m, 5, k), the largest first.
        directions: the inertial parameters' change by these deviates, (10 n_links, k).
        load_rates: first to third derivative of the moments about the soles, (m, 3, 2, 2) [Nm/s, Nm/s2,
            Nm/s3], see `Observation.sole_loads`. Soles yield late, and a body on soft feet is accelerated.
        rocking: derivative by rate and acceleration of roll and of pitch of the foot that carries,
            (m, 5, 4).
        yielding: derivative by the compliance of every joint, whose link is accelerated against its encoder
            as its load changes, (m, 5, n_joints).
        between: mean pose of the swing sole over each row's window less the pose in the mean posture,
            x, y, z, roll, pitch, yaw, (m, 6) [m, rad]. The postures between are not on a straight line.
        rate: derivative by time of all five, with the weight's centre of pressure, by CAD, (m, 5)
            [m/s, m/s, N/s, 1/s, 1/s]. Contacts that are read late read what was.
        of_links: what each link needs by CAD beyond its weight, see `link_wrenches`, (m, n_links, 6).
        shown: whether the contact sensors show these forces.
    """

    by_cad: np.ndarray
    slope: np.ndarray
    unknown: np.ndarray
    directions: np.ndarray
    load_rates: np.ndarray
    rocking: np.ndarray
    yielding: np.ndarray
    between: np.ndarray
    rate: np.ndarray
    of_links: np.ndarray
    shown: bool = field(default=True, kw_only=True)

    def take(self, rows: np.ndarray) -> Self:
        names = [one.name for one in fields(self) if one.name not in ("directions", "shown")]
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


NOTHING = (
    *((0, 5), (0, 5, 0), (0, 5, 0), (0, 0), (0, 3, 2, 2)),
    *((0, 5, 4), (0, 5, 0), (0, 6), (0, 5), (0, 0, 6)),
)
HELD = BeyondWeight(*map(np.zeros, NOTHING))


def beyond_weight(
    nominal: Nominal, measurements: Measurements, directions: np.ndarray | None = None
) -> BeyondWeight:
    """Compute what motion adds to the robot's weight; nothing for a robot that is held.

    The mean over a row's window is not that of the mean posture: the postures between count too.

    Args:
        directions: of another motion; None: those that this one shows.
    """
    if measurements.joint_rates is None and measurements.joint_accelerations is None:
        return HELD
    held = replace(measurements, joint_rates=None, joint_accelerations=None)
    still, moving = wrench_regressor(nominal, held), np.zeros(())
    for at, share in QUADRATURE:
        moving = moving + share * wrench_regressor(nominal, _within(measurements, at))
    cad, weight = _by_cad(nominal, measurements)
    (after, by_after), (before, by_before) = (_pressure(w, cad) for w in (moving, still))
    added = moving - still
    each = np.concatenate([by_after - by_before, added[:, 2:3], added[:, :2] / weight], axis=1)
    by_all = each.reshape(*each.shape[:2], -1)  # (m, 5, 10 n_links)
    forces = added.reshape(*added.shape[:2], -1) @ cad.ravel()
    by_cad = np.column_stack([after - before, forces[:, 2], forces[:, :2] / weight])
    depth = _depth(measurements)  # a horizontal force acts on cells below the soles with a lever
    for values in (by_all, by_cad):
        values[:, :2] -= depth * values[:, 3:]
    known, rest = _given_base_parameters(nominal, cad)
    if directions is None:  # of those that are left, the ones in which the forces change most
        shift = by_all @ rest * np.array([1.0, 1.0, LENGTH / weight, LENGTH, LENGTH])[:, None]
        flat = shift.reshape(-1, rest.shape[1])
        squares, turn = np.linalg.eigh(flat.T @ flat / len(measurements))
        most = squares[::-1][:MOST_DIRECTIONS] > LEAST_SHIFT**2
        directions = rest @ turn[:, ::-1][:, :MOST_DIRECTIONS][:, most]
    shapes = (*NOTHING[4:6], (0, 5, measurements.joint_angles.shape[1]))
    none = [np.zeros((len(measurements), *shape[1:])) for shape in shapes]
    return BeyondWeight(
        *(by_cad, by_all @ known, by_all @ directions, directions),
        *none,
        between=_between(nominal, measurements),
        rate=_rate(nominal, measurements),
        of_links=np.einsum("mklp,lp->mlk", added, cad),
    )


def _between(nominal: Nominal, measurements: Measurements) -> np.ndarray:
    """Compute `BeyondWeight.between`."""

    def pose(angles: np.ndarray) -> np.ndarray:
        standard, tree = standard_parameters(nominal.robot.model), nominal.parameters.tree
        place, turn = PostureGeometry(nominal, tree, angles, measurements.support, standard).swing_sole
        return np.column_stack([place, roll_pitch_yaw(turn)])

    mean = sum(share * pose(_within(measurements, at).joint_angles) for at, share in QUADRATURE)
    return mean - pose(measurements.joint_angles)


def _rate(nominal: Nominal, measurements: Measurements) -> np.ndarray:
    """Compute `BeyondWeight.rate` by central differences.

    Noise of the jerks would make every lag too short: of each joint only that share is taken that they vary
    by beyond it (regression calibration, Carroll et al. 2006).
    """
    m, (cad, weight) = measurements, _by_cad(nominal, measurements)
    rates, faster = rates_of(m)
    jerks = np.zeros_like(rates)
    if m.joint_jerks is not None:
        half = m.window[:, None] / 2
        noise = JERK_NOISE * m.joint_angles_sd**2 / (m.samples[:, None] * half**6)
        size = (m.joint_jerks**2).mean(axis=0)
        share = 1 - np.divide(noise.mean(axis=0), size, out=np.ones_like(size), where=size > 0)
        jerks = np.maximum(share, 0.0) * m.joint_jerks
    both = []
    for at in (INSTANT, -INSTANT):
        there = replace(
            m,
            joint_angles=m.joint_angles + at * rates + at**2 / 2 * faster + at**3 / 6 * jerks,
            joint_rates=rates + at * faster + at**2 / 2 * jerks,
            joint_accelerations=faster + at * jerks,
        )
        wrench = np.einsum("mlik,lk->mi", _regressor(nominal, there)[0], cad)
        push = wrench[:, :2] / weight
        center = np.column_stack([-wrench[:, 4], wrench[:, 3]]) / wrench[:, 2:3]
        both.append(np.column_stack([center - _depth(m) * push, wrench[:, 2], push]))
    return (both[0] - both[1]) / (2 * INSTANT)


def rocking(nominal: Nominal, measurements: Measurements) -> np.ndarray:
    """Compute `BeyondWeight.rocking` by CAD, by central differences."""
    cad, weight = _by_cad(nominal, measurements)
    out = []
    for turning in ROCKED * np.eye(6)[[0, 1, 3, 4]]:
        after, before = (
            np.einsum("mlik,lk->mi", _regressor(nominal, measurements, sign * turning)[0], cad)
            for sign in (1, -1)
        )
        force = (after - before)[:, :3] / [weight, weight, 1.0]
        center = [np.column_stack([-w[:, 4], w[:, 3]]) / w[:, 2:3] for w in (after, before)]
        center = center[0] - center[1] - _depth(measurements) * force[:, :2]
        change = np.column_stack([center, force[:, 2], force[:, :2]])
        out.append(change / (2 * ROCKED))
    return np.stack(out, axis=2)


def yielding(
    geometry: PostureGeometry, measurements: Measurements, torques: Callable[[float], np.ndarray]
) -> np.ndarray:
    """Compute `BeyondWeight.yielding` by the torques of the loads a time after each row, in s."""
    before, now, after = (torques(at) for at in (-LATER, 0.0, LATER))
    bending = (after - 2 * now + before) / LATER**2
    return by_accelerations(geometry, measurements) * bending[:, None]


def by_accelerations(geometry: PostureGeometry, measurements: Measurements) -> np.ndarray:
    """Differentiate what `BeyondWeight` adds by the joints' accelerations, by CAD, (m, 5, n_joints).

    A joint turns the links beyond it as one body. Its force is that of their first moment about the pivot,
    its moment that of their inertia about the origin.
    """
    nominal, tree = geometry.nominal, geometry.tree
    (cad, weight), links = _by_cad(nominal, measurements), np.array(tree.frame_of_link)
    rotations, positions = (each[:, links] for each in geometry.frames)
    mass, own = cad[:, 0], (rotations @ cad[:, 1:4, None])[..., 0]
    both = positions[..., None] * own[..., None, :]
    moved = mass[:, None, None] * positions[..., None] * positions[..., None, :] + both + both.mT
    moved = np.trace(moved, axis1=2, axis2=3)[..., None, None] * np.eye(3) - moved
    inertia = rotations @ cad[:, 4:][:, SYMMETRIC] @ rotations.mT + moved  # about the base frame's origin
    beyond = geometry.moved[:, links] - 1.0 * (
        geometry.on_swing_foot[:, None, None] * geometry.moved[:, nominal.swing_frame, None]
    )
    moment = np.einsum("mnl,mla->mna", beyond, mass[:, None] * positions + own)
    axes, pivots = geometry.axes, geometry.pivots
    force = np.cross(axes, moment - (beyond @ mass)[..., None] * pivots)
    turning = np.einsum("mnl,mlab,mnb->mna", beyond, inertia, axes, optimize=True)
    turning = turning - np.cross(moment, np.cross(axes, pivots))
    push, center = force[..., :2] / weight, geometry.center[:, None]
    shift = np.stack([-turning[..., 1], turning[..., 0]], axis=2) - center[..., :2] * force[..., 2:]
    shift = shift / weight - _depth(measurements) * push
    return np.concatenate([shift, force[..., 2:], push], axis=2).mT


def acceleration_sd(measurements: Measurements, encoder_sd: float, lasting: NoiseInTime) -> np.ndarray:
    """Return the s.d. of the joints' accelerations by the noise of the encoders, (m, n_joints) [rad/s2].

    Noise that lasts longer than a window is a random walk within it. Joints that were not measured have none.
    """
    m, half = measurements, measurements.window[:, None] / 2
    quick = ACCELERATION_NOISE * np.nan_to_num(m.joint_angles_sd) ** 2 / (m.samples[:, None] * half)
    slow = OF_A_WALK * lasting.share * 2 * encoder_sd**2 / lasting.seconds
    return np.sqrt((quick + slow) / half**3)


def _depth(measurements: Measurements) -> float:
    """Return how far below the soles the plane lies to which the readings of plates refer [m]."""
    contacts = measurements.contacts
    if contacts is None:
        return float(measurements.top_height[0])
    return 0.0 if contacts.mount == "foot" else contacts.depth


def _pressure(regressor: np.ndarray, cad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of pressure by CAD, (m, 2) [m], and its derivative, (m, 2, n_links, 10)."""
    wrench = np.einsum("milk,lk->mi", regressor, cad)
    down = wrench[:, 2]
    center = np.column_stack([-wrench[:, 4], wrench[:, 3]]) / down[:, None]
    moments = np.stack([-regressor[:, 4], regressor[:, 3]], axis=1)
    slope = moments - center[:, :, None, None] * regressor[:, 2][:, None]
    return center, slope / down[:, None, None, None]


def _given_base_parameters(nominal: Nominal, cad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how inertial parameters follow from base parameters, and what is left of CAD's doubt.

    The first are the most likely ones of a robot of known mass, (10 n, p) [kg, ...]; the second is the change
    by independent deviates of s.d. 1, (10 n, 10 n).
    """
    spread = _doubt(nominal.robot.model, cad)
    parameters, n, mass = nominal.parameters, len(cad), cad[:, 0].sum()
    shows = np.zeros((len(parameters.names) + 1, n, 10))
    shows[:-1, :, :4] = parameters.from_standard.reshape(-1, n, 4) / mass
    shows[-1, :, 0] = 1.0
    seen = shows.reshape(len(shows), -1) @ spread
    gain = spread @ np.linalg.pinv(seen, rcond=1e-9)
    return gain[:, :-1], spread - gain @ seen


def _doubt(model: mujoco.MjModel, cad: np.ndarray) -> np.ndarray:
    """Return the change of all inertial parameters by CAD's independent errors of s.d. 1, (10 n, 10 n).

    A link's mass takes its moments along; its centre moves; its density's second moments about the centre
    are uncertain in its principal axes, and those axes too.
    """
    n = len(cad)
    out = np.zeros((n, 10, n, 10))
    each, mass = np.arange(n), cad[:, 0]
    out[each, :, each, 0] = MASS_SD * cad
    standard, none = cad[:, :4], np.zeros((n, 3, 3))
    for axis in range(3):
        step = np.zeros((n, 4))
        step[:, 1 + axis] = CENTER_SD * mass
        moved = [moved_inertia(standard + sign * step, none) for sign in (1, -1)]
        out[each, :, each, 1 + axis] = np.column_stack([step, (moved[0] - moved[1]) / 2])
    principal = rotation_matrices(model.body_iquat[1:])
    moment = mass.sum() / model.body_mass[1:].sum() * model.body_inertia[1:]
    radii = np.sqrt(np.maximum(moment.sum(axis=1, keepdims=True) / 2 - moment, 0.0))  # times root of mass
    for k, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        second = np.zeros((n, 3, 3))
        second[:, a, b] = second[:, b, a] = INERTIA_SD * radii[:, a] * radii[:, b]
        inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
        out[each, 4:, each, 4 + k] = moved_inertia(0 * standard, principal @ inertia @ principal.mT)
    return out.reshape(10 * n, 10 * n)


def _within(measurements: Measurements, at: float) -> Measurements:
    """Return the motion at a time in each row's window, from -1 to 1, by the means of the row."""
    m = measurements
    half = np.where(np.isfinite(m.window), m.window, 0.0)[:, None] / 2
    rates, faster = rates_of(m)
    angles = m.joint_angles + half * at * rates + half**2 * (at**2 - 1 / 7) / 2 * faster
    return replace(m, joint_angles=angles, joint_rates=rates + half * at * faster)


def _of_foot(
    nominal: Nominal,
    foot: str,
    sole: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    gravity: float,
    foot_turns: Sequence[float] | np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute `wrench_regressor` and centres of mass, with the foot accelerated upward in place of gravity.

    Angles, rates and accelerations of the joints are (m, n_joints) each; the sole point is in the foot's
    frame, (3,) [m]. The foot turns about its sole point at a rate and an acceleration, (6,) [rad/s, rad/s2].
    """
    tree = nominal.parameters.tree
    angles, rates, accelerations = motion
    base = tree.frame(foot)
    rotations = link_rotations(tree, base, angles)
    positions = frame_positions(tree, base, rotations, -sole)
    turning, turning_faster, faster = np.zeros((3, *positions.shape))  # of every frame: w, dw/dt and dv/dt
    turning[:, base], turning_faster[:, base] = np.split(np.asarray(foot_turns), 2)
    faster[:, base] = _swept(turning[:, base], turning_faster[:, base], -sole)
    faster[:, base, 2] += gravity
    for step in walk(tree, base):
        known, new, edge = step.known, step.new, step.edge
        w, dw = turning[:, known], turning_faster[:, known]
        pivot = faster[:, known] + _swept(w, dw, rotations[:, known] @ step.anchor_known)
        if edge.axis is not None:
            axis = rotations[:, edge.child] @ (edge.axis if step.forward else -edge.axis)
            spin = axis * rates[:, [edge.joint]]
            dw = dw + axis * accelerations[:, [edge.joint]] + np.cross(w, spin)
            w = w + spin
        turning[:, new], turning_faster[:, new] = w, dw
        faster[:, new] = pivot - _swept(w, dw, rotations[:, new] @ step.anchor_new)
    links = np.array(tree.frame_of_link)
    turn, place, pull = rotations[:, links], positions[:, links], faster[:, links]
    w, dw = turning[:, links], turning_faster[:, links]
    out = np.zeros((*place.shape[:2], 6, 10))
    swept = _crossing(dw) + _crossing(w) @ _crossing(w)
    out[..., :3, 0] = pull
    out[..., :3, 1:4] = swept @ turn
    out[..., 3:, 0] = np.cross(place, pull)
    out[..., 3:, 1:4] = (_crossing(place) @ swept - _crossing(pull)) @ turn
    # In the link's axes I dw + w x I w is linear in the six elements of I.
    own, faster_own = (np.einsum("mlij,mli->mlj", turn, v) for v in (w, dw))
    out[..., 3:, 4:] = turn @ (_elements(faster_own) + _crossing(own) @ _elements(own))
    model = nominal.robot.model
    center = place + (turn @ model.body_ipos[1:, :, None])[..., 0]
    return out, center


def _crossing(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices of the cross product by vectors, (..., 3) -> (..., 3, 3)."""
    return (vectors @ CROSSES).reshape(*vectors.shape, 3)


def _elements(vectors: np.ndarray) -> np.ndarray:
    """Return I v as a linear function of I's elements xx, xy, yy, xz, yz, zz, (..., 3) -> (..., 3, 6)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    o = np.zeros_like(x)
    rows = [[x, y, o, z, o, o], [o, x, y, o, z, o], [o, o, o, x, y, z]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _swept(turning: np.ndarray, turning_faster: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return the acceleration of the end of an arm that turns with a frame, (..., 3) [m/s2]."""
    twice = _crossing(turning) @ _crossing(turning)
    return ((_crossing(turning_faster) + twice) @ arm[..., None])[..., 0]
