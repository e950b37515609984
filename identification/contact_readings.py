"""Readings of the contact sensors as forces and levers, for any kind of sensor.

Every reading, of a cell or of a channel of a wrench sensor, adds to the vertical force on its foot and to
force times place: `bears` and `levers` say how much a unit of it adds. A cell bears its force at its place.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from tulip_testbed.identification.kinematics import turned_about
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.contacts import WRENCH, Contacts
from tulip_testbed.measurements.data import feet_in_contact

ASSUMED_FORCE, ASSUMED_MOMENT = 1.0, 0.05  # N, Nm: noise of a wrench sensor without a data sheet
UNSURE = 0.5  # of a reading's noise
LEAST_NOISE = 1e-6  # of the assumed variance, that every channel has
# S.d. of a zero of which nothing is known, in weights of the robot; assumed: a larger one would be noticed.
WIDE_FORCE, WIDE_MOMENT = 0.5, 0.1  # -, m
# Of a log, whose sensors were tared at some time before; assumed.
MOVING_FORCE, MOVING_MOMENT = 0.1, 0.03  # -, m
# Range of moments over that of forces [m]: 60 Nm and 2000 N, 30 Nm and 1000 N of humanoids' feet; 20 Nm and
# 580 N of ATI's Mini45.
LEVER = 0.03
LEAST_LOAD = 0.5  # N
CROSSTALK = 0.01  # of the load on a board that a cell in the air may read
NEARLY_ALL = 0.9  # of the postures
ROCKING = 2.0  # times the usual s.d. of a board's cells within a row: more is no noise


@dataclass(frozen=True)
class ContactReadings:
    """Readings of k numbers a foot, right then left, scaled so that each has the same independent noise.

    Attributes:
        values: (m, 2 k). Those of wrench sensors are corrected for what is known of their zeros.
        bears: vertical force of a unit of each reading, (2, k) [-]; 1 for a cell.
        levers: force times place of a unit of each, in the sensor's plane, (2, k, 2) [m].
        pushes: horizontal force of a unit of each, in the foot's axes, (2, 2, k) [-]; None: not measured.
        sd: noise of every reading; 0: unknown or none.
        by_channel: scaled readings by the channels of each wrench sensor, (k, c) [1/N, 1/Nm]; None: cells.
        zero_sd: s.d. of what is left of each channel's zero, (2, c) [N, Nm]; 0: exact. None: cells.
        below: part of `values` that is the weight of what is below each sensor, (m, 2 k); None: cells.
        unknown: whether nothing is known of it, (2, c) bool; None: cells.
    """

    values: np.ndarray
    bears: np.ndarray
    levers: np.ndarray
    sd: float
    by_channel: np.ndarray | None = None
    zero_sd: np.ndarray | None = None
    below: np.ndarray | None = None
    unknown: np.ndarray | None = None
    pushes: np.ndarray | None = None

    @cached_property
    def by_reading(self) -> np.ndarray:
        """Return the channels of a wrench sensor by its scaled readings, (c, k) [N, Nm]."""
        assert self.by_channel is not None
        return np.linalg.inv(self.by_channel)

    @property
    def unsure(self) -> np.ndarray:
        """Return of which channels the zero is no better known than half a reading's noise, (2, c) bool."""
        if self.zero_sd is None or self.by_channel is None:
            return np.zeros((2, 0), bool)
        noise = np.linalg.norm(self.by_reading, axis=1)
        return self.zero_sd > UNSURE * noise

    def rates(self, measurements: Measurements) -> list[np.ndarray] | None:
        """Return the first to third derivative of `values` by time, (m, 2 k) each.

        Jerks that were not measured are zero; None: nor were rates or accelerations.
        """
        m = measurements
        measured = [m.cell_rates, m.cell_accelerations, None]
        if m.contacts is not None:
            measured = [m.wrench_rates, m.wrench_accelerations, m.wrench_jerks]
        if measured[0] is None or measured[1] is None:
            return None
        by_channel = np.eye(measured[0].shape[-1]) if self.by_channel is None else self.by_channel
        return [
            np.zeros_like(self.values)
            if rate is None
            else (np.nan_to_num(rate) @ by_channel.T).reshape(len(m), -1)
            for rate in measured
        ]

    def take(self, rows: np.ndarray) -> Self:
        below = None if self.below is None else self.below[rows]
        return replace(self, values=self.values[rows], below=below)


def contact_readings(measurements: Measurements, nominal: Nominal) -> ContactReadings:
    """Return the readings of the contact sensors, with the feet's tilt by the joint angles."""
    if measurements.contacts is None:
        return of_cells(measurements)
    parameters = nominal.parameters
    rotations = parameters.rotations(measurements.joint_angles, measurements.support)
    upright = rotations[:, [parameters.base, nominal.swing_frame], 2]
    mass = measurements.weighed_mass[0] if measurements.weighed_mass else nominal.mass
    return of_wrenches(measurements, nominal.points, upright, mass * measurements.gravity)


def of_cells(measurements: Measurements) -> ContactReadings:
    forces, cells = measurements.cell_forces, measurements.cells
    forces = np.where(np.isfinite(forces), forces, 0.0)
    return ContactReadings(forces, np.ones(cells.shape[:2]), cells, measurements.sensors.cell_sd or 0.0)


def of_wrenches(
    measurements: Measurements, soles: np.ndarray, upright: np.ndarray, weight: float
) -> ContactReadings:
    """Return the readings of wrench sensors.

    The weight of what is below a sensor is added. A foot in the air shows the zeros of its sensor: they are
    subtracted, and what is not known of them is stated.

    Args:
        soles: sole point of each foot in its frame, (2, 3) [m].
        upright: vertical direction in each foot's frame, (m, 2, 3).
        weight: of the robot, roughly [N].
    """
    contacts, wrenches = measurements.contacts, measurements.wrenches
    assert contacts is not None
    assert wrenches is not None
    below = _weight_below(contacts, upright, measurements.gravity)
    known = wrenches + below
    covariance = noise_of_wrenches(contacts)
    stands = feet_in_contact(measurements.support)
    held = measurements.joint_rates is None
    sizes = (WIDE_FORCE, WIDE_MOMENT) if held else (MOVING_FORCE, MOVING_MOMENT)
    wide = weight * by_kind(contacts.channels, *sizes)
    zero, zero_sd = _zeros(contacts, known, stands, covariance, wide)
    root = np.linalg.cholesky(covariance)
    by_channel = np.linalg.inv(root)
    scaled = np.where(np.isfinite(known), known - zero, 0.0) @ by_channel.T
    gathered = np.array([_gather(contacts, side, sole) @ root for side, sole in enumerate(soles)])
    exact = contacts.covariance is not None and not np.any(contacts.covariance)
    return ContactReadings(
        values=scaled.reshape(len(scaled), -1),
        bears=gathered[:, 0],
        levers=gathered[:, 1:3].mT,
        sd=0.0 if exact else 1.0,
        by_channel=by_channel,
        zero_sd=zero_sd,
        below=(below @ by_channel.T).reshape(len(scaled), -1),
        unknown=zero_sd > 0.5 * wide,
        pushes=gathered[:, 3:] if contacts.channels == WRENCH else None,
    )


def noise_of_wrenches(contacts: Contacts) -> np.ndarray:
    """Return the stated or else an assumed covariance of a posture's averaged reading, (c, c) [N, Nm].

    A channel without noise gets a millionth of the assumed variance, so that readings can be scaled.
    """
    assumed = np.diag(by_kind(contacts.channels, ASSUMED_FORCE, ASSUMED_MOMENT) ** 2)
    stated = contacts.covariance
    return assumed if stated is None or not np.any(stated) else stated + LEAST_NOISE * assumed


def by_kind(channels: tuple[str, ...], force: float, moment: float) -> np.ndarray:
    """Return one number for every force and another for every moment, (c,)."""
    return np.array([force if channel.startswith("f") else moment for channel in channels])


def _in_full(contacts: Contacts) -> list[int]:
    """Return the places of the channels in the full wrench."""
    return [WRENCH.index(channel) for channel in contacts.channels]


def _weight_below(contacts: Contacts, upright: np.ndarray, gravity: float) -> np.ndarray:
    """Return what the sensors would read more if they bore the weight of what is below, (m, 2, c)."""
    out = np.zeros((len(upright), 2, len(contacts.channels)))
    for side in (0, 1):
        turn = turned_about(contacts.pose[side, 3:])
        force = contacts.below[side, 0] * gravity * upright[:, side] @ turn
        arm = (contacts.below[side, 1:] - contacts.pose[side, :3]) @ turn
        out[:, side] = np.concatenate([force, np.cross(arm, force)], axis=1)[:, _in_full(contacts)]
    return out


def _zeros(
    contacts: Contacts, known: np.ndarray, stands: np.ndarray, covariance: np.ndarray, wide: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the zeros from the feet in the air and from what was stated: values and s.d., (2, c) each.

    If nothing is stated, and one sensor in a foot alone was in the air, the other's zeros are as large: their
    s.d. is that of Student's t, whose scale is the root mean square of the n zeros that were seen. Zeros of
    exactly 0 show nothing: programs write them for a foot in the air.
    """
    exact = contacts.covariance is not None and not np.any(contacts.covariance)
    variance = np.zeros(len(covariance)) if exact else np.diag(covariance)
    zero, zero_sd = np.zeros_like(contacts.zero_sd), np.minimum(contacts.zero_sd, wide)
    shown = list[int]()
    for side in (0, 1):
        air = known[~stands[:, side], side]
        air = air[np.isfinite(air).all(axis=1)]
        if not len(air) or not zero_sd[side].any():
            continue
        own, prior = variance / len(air), zero_sd[side] ** 2
        share = np.divide(prior, prior + own, out=np.zeros_like(prior), where=prior > 0)
        zero[side], zero_sd[side] = share * air.mean(axis=0), np.sqrt(share * own)
        shown.append(side)
    alike = contacts.mount == "foot" and np.isinf(contacts.zero_sd).all()
    if alike and len(shown) == 1 and zero[shown].any():
        scale, n = by_kind(contacts.channels, 1.0, LEVER), len(wide)
        square = ((zero[shown] ** 2 + zero_sd[shown] ** 2) / scale**2).mean()
        zero_sd[1 - shown[0]] = np.minimum(scale * np.sqrt(square * n / (n - 2)), wide)
    return zero, zero_sd


def _gather(contacts: Contacts, side: int, sole: np.ndarray) -> np.ndarray:
    """Return vertical force, force times place (x, y) and horizontal force by the channels, (5, c).

    The foot is level. The place is that on the ground, in the foot's axes from its sole point; on a plate, in
    the plate's axes.
    """
    turn = turned_about(contacts.pose[side, 3:])
    arm = contacts.pose[side, :3] - sole if contacts.mount == "foot" else np.zeros(3)
    force = np.concatenate([turn, np.zeros((3, 3))], axis=1)
    moment = np.concatenate([np.cross(arm, turn.T).T, turn], axis=1)
    rows = (force[2], -moment[1], moment[0], force[0], force[1])
    return np.stack(rows)[:, _in_full(contacts)]


def margin_of_load(cell_sd: float) -> float:
    """Return by how much a cell has to read more than without load, so that it bears one [N]."""
    return max(LEAST_LOAD, 4 * cell_sd)


def on_four_cells(
    forces: np.ndarray, margin: float, share: np.ndarray, spread: np.ndarray | None
) -> np.ndarray:
    """Return whether all cells of each plate are loaded, (m, 2) bool.

    A board that rocks was tared on two cells, so the one of the others that is in the air reads nothing. That
    counts only if it is so in nearly all postures: a board that does not rock may have such readings by
    chance, and noise may hide one. A cell in the air may read a part of the load on the others.

    Args:
        forces: (m, 2, 4) [N].
        margin: of a reading over that of no load [N].
        share: of a board's weight on each of its cells, (2,) [N].
        spread: s.d. of the cells' samples within each row of a moving record, (m, 2, 4) [N]; None: it holds.
    """
    load = forces.sum(axis=2)
    margins = margin + CROSSTALK * np.maximum(load, 0.0)
    idle = np.abs(forces) < margins[..., None]
    loaded = load > 4 * margins
    one_of_two = np.stack([idle[..., k] | idle[..., k + 2] for k in (0, 1)], axis=-1) & loaded[..., None]
    rocks = one_of_two.sum(axis=0).max(axis=-1) > NEARLY_ALL * loaded.sum(axis=0)
    on_all = (forces.min(axis=2) > margins - share) & ~rocks
    return on_all if spread is None else on_all & _steady(spread)


def _steady(spread: np.ndarray) -> np.ndarray:
    """Return on which boards no cell lifted or landed within a row's window, (m, 2) bool.

    There the board rocks over its diagonal at once, which the s.d. of its cells' samples, (m, 2, 4) [N],
    shows. A row without samples is no witness.
    """
    most = spread.max(axis=2)
    usual = np.nanmedian(most, axis=0) if np.isfinite(most).any() else np.inf
    return ~(most > ROCKING * usual)
