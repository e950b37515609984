"""Steps of an experiment that both engines share, from the order of postures to the data contract."""

from dataclasses import replace
from typing import Any

import numpy as np

from tulip_testbed.measurements import MeasurementHeader, Measurements, PosturePlan, SensorSheet
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.measurements.contacts import (
    COP,
    VERTICAL,
    Contacts,
    cops_of_wrenches,
    covariance_of_cops,
    wrenches_of_cops,
)
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.sensors import (
    ANKLE,
    PLATE,
    Sampling,
    WrenchSensors,
    averaged_sd,
    cell_gains,
    read_wrenches,
    sample,
)
from tulip_testbed.sim.wrench_sensors import mountings, nominal_feet


def record_error(rig: Rig, rng: np.random.Generator, placements: int) -> np.ndarray:
    """Draw the errors of both plates' recorded poses, (placements, 2, 3) [m, m, rad].

    The right plate has `mark_sd`, the left one `placement_sd`, in every support.
    """
    sd = np.array([rig.sensors.mark_sd, rig.sensors.placement_sd])
    return sd * rng.standard_normal((placements, 2, 3))


def choose_repeats(plan: PosturePlan, count: int, rng: np.random.Generator) -> frozenset[int]:
    """Draw the numbers of the postures to measure twice; none if the plan has repeats of its own."""
    if plan.postures < len(plan):
        return frozenset()
    chosen = rng.choice(plan.posture, size=min(count, len(plan)), replace=False)
    return frozenset(int(number) for number in chosen)


def order_of_tries(plan: PosturePlan, placement: int, repeats: frozenset[int]) -> list[tuple[int, bool]]:
    """List the plan's rows in the order in which a placement tries them, each with whether it is a repeat."""
    rows = np.flatnonzero(plan.placement == placement).tolist()
    return [(row, False) for row in rows] + [(row, True) for row in rows if int(plan.posture[row]) in repeats]


def new_set_up(placement: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Return whether a new set-up begins at an attempt, for all but the first, (k - 1,) bool."""
    return (placement[1:] != placement[:-1]) | (support[1:] != support[:-1])


def start_times(rig: Rig, placement: np.ndarray) -> np.ndarray:
    """Compute when the averaged window of every attempt begins, (k,) [s], by their placements in order."""
    p = rig.protocol
    fresh = np.append(True, placement[1:] != placement[:-1])
    held = p.rest_time + p.hold_time
    return np.cumsum(np.where(fresh, p.placement_time, p.move_time) + held) - p.window


def stage_at(starts: np.ndarray, time: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the index of the rig's stage at every attempt, (k,) int.

    The experiment's time runs from the first to the last usable posture, and which postures are usable
    depends on the stage; hence the iteration.

    Args:
        starts: start of every stage as a fraction of the experiment's time, the first 0, (s,).
        time: time of every attempt, (k,) [s].
        used: whether an attempt is usable in a stage, (s, k) bool.
    """
    every = np.arange(len(time))
    stage = np.searchsorted(starts, (time - time[0]) / max(np.ptp(time), 1e-9), side="right") - 1
    for _ in starts:
        kept = time[used[stage, every]]
        if not len(kept):
            break
        part = (time - kept[0]) / max(np.ptp(kept), 1e-9)
        stage = np.maximum(np.searchsorted(starts, part, side="right") - 1, 0)
    return stage


def weigh(rig: Rig, mass: float, rng: np.random.Generator) -> tuple[float, float]:
    """Draw the scale's reading of the whole robot and return it with its s.d. [kg]."""
    return mass + rig.sensors.weighed_mass_sd * rng.standard_normal(), rig.sensors.weighed_mass_sd


def header_of(rig: Rig) -> MeasurementHeader:
    """Return what a rig's user knows before measuring."""
    s = rig.sensors
    plates = nominal_plates(rig.robot)
    samples = _samples(rig)
    sheet = SensorSheet(encoder_sd=averaged_sd(*s.encoder, samples), encoder_resolution=s.encoder_resolution)
    on_ground = s.wrench is None or s.wrench.place == PLATE
    if on_ground:
        sheet = replace(sheet, placement_sd=s.placement_sd)
    if s.wrench is None:
        sheet = replace(sheet, cell_sd=averaged_sd(*s.cell, samples), cell_resolution=s.cell_resolution)
    return MeasurementHeader(
        robot={
            "model": rig.robot.model_file.name,
            "sha256": rig.robot.model_hash,
            "stance_foot": rig.robot.stance_foot,
            "swing_foot": rig.robot.swing_foot,
        },
        joints=joint_names(rig.robot.model),
        cells=np.array([plate.cells for plate in plates]) if s.wrench is None else np.zeros((2, 0, 2)),
        top_height=np.array([plate.top_height if on_ground else 0.0 for plate in plates]),
        gravity=float(-rig.robot.model.opt.gravity[2]),
        sensors=sheet,
        contacts=None if s.wrench is None else contacts_of(rig, s.wrench),
    )


def contacts_of(rig: Rig, sensors: WrenchSensors) -> Contacts:
    """Return what a user knows of the wrench sensors: the data sheet, and the nominal foot below an ankle.

    The covariance of centres of pressure depends on the load and is not known before the measurements.
    """
    sd = np.array([averaged_sd(*figures, _samples(rig)) for figures in sensors.figures()])
    is_cop, in_foot = sensors.channels == COP, sensors.place != PLATE
    below, below_sd = np.zeros((2, 4)), np.zeros((2, 4))
    if sensors.place == ANKLE:
        below = nominal_feet(rig.robot)
        below_sd = np.full_like(below, sensors.below_center_sd)
        below_sd[:, 0] = sensors.below_mass_sd * below[:, 0]
    zero_sd = np.array(sensors.zero_sd[: len(sd)])
    return Contacts(
        mount="foot" if in_foot else "ground",
        channels=VERTICAL if is_cop else sensors.channels,
        pose=mountings(sensors, rig.robot) if in_foot else np.zeros((2, 6)),
        covariance=None if is_cop else np.diag(sd**2),
        zero_sd=np.tile(np.where(zero_sd > 0, np.inf, 0.0), (2, 1)),
        below=below,
        below_sd=below_sd,
        cop_sd=np.tile(sd, (2, 1)) if is_cop else None,
    )


def _samples(rig: Rig) -> int:
    return round(rig.protocol.window * rig.sensors.sample_rate)


def read_sensors(
    rig: Rig,
    joints: np.ndarray,
    motors: np.ndarray,
    forces: np.ndarray,
    wrenches: np.ndarray | None,
    zeros: np.ndarray | None,
    rng: np.random.Generator,
    sample: Sampling = sample,
) -> dict[str, np.ndarray]:
    """Read encoders and either cells or wrench sensors over a window; return the readings by column prefix.

    Args:
        joints, motors: true angles, (..., n) [rad]. forces: of the cells, (..., 8) [N].
        wrenches, zeros: true wrenches and zeros of the wrench sensors, (..., 2, 6) and (2, c) [N, Nm]; not
            read without such sensors.
        sample: `sample` to draw every sample, or `sample_mean`.
    """
    samples, sensors = _samples(rig), rig.sensors.wrench
    angles, angles_sd = sample(joints, rig.sensors.encoder, samples, rng)
    motor, _ = sample(motors, rig.sensors.motor, samples, rng)
    reading = {"q": angles, "q_std": angles_sd, "motor": motor}
    if sensors is None or wrenches is None or zeros is None:
        if wrenches is not None and np.any(rig.side_forces):
            side = (wrenches[..., :2] * rig.side_forces).sum(axis=-1)
            forces = forces + np.repeat(side / len(CORNERS), len(CORNERS), axis=-1)
        mean, sd = sample(cell_gains(rig.sensors) * forces, rig.sensors.cell, samples, rng)
        return reading | {"cell": mean, "cell_std": sd}
    mean, sd = read_wrenches(sensors, wrenches, zeros, samples, rng, sample)
    return reading | {"wrench": mean, "wrench_std": sd}


def make_measurements(
    rig: Rig,
    header: MeasurementHeader,
    reading: dict[str, np.ndarray],
    weighed_mass: tuple[float, float],
    **rows: Any,
) -> Measurements:
    """Assemble the measurements of m held postures and apply the rig's `misread`.

    The readings are those of `read_sensors`; `rows` are the other values of the rows.
    """
    m, sensors, contacts = len(reading["q"]), rig.sensors.wrench, header.contacts
    if sensors is not None and sensors.place != PLATE:  # the plates are only the ground that it stands on
        del rows["plate_poses"]
    if sensors is not None and sensors.channels == COP and contacts is not None:
        stands = feet_in_contact(rows["support"])
        cops = np.where(stands[..., None], reading["wrench"], np.nan)  # nothing presses in the air
        cops = cops_of_wrenches(wrenches_of_cops(cops))  # to the last bit those that a folder gives back
        assert contacts.cop_sd is not None
        contacts = replace(contacts, covariance=covariance_of_cops(cops, contacts.cop_sd, stands))
        reading = reading | {"wrench": wrenches_of_cops(cops), "wrench_std": np.full(cops.shape, np.nan)}
    measured = Measurements.from_arrays(
        replace(header, weighed_mass=weighed_mass, contacts=contacts),
        window=np.full(m, rig.protocol.window),
        samples=np.full(m, _samples(rig)),
        joint_angles=reading["q"],
        joint_angles_sd=reading["q_std"],
        motor=reading["motor"],
        cell_forces=reading.get("cell"),
        cell_forces_sd=reading.get("cell_std"),
        wrenches=reading.get("wrench"),
        wrenches_sd=reading.get("wrench_std"),
        **rows,
    )
    return measured if rig.misread is None else rig.misread(measured)
