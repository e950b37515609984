"""The contract of measurements: what every row and every figure has to be, in a folder as in memory."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from tulip_testbed.base.arguments import expect
from tulip_testbed.base.errors import InputError, look_up, shortened
from tulip_testbed.base.table_files import refuse_rows
from tulip_testbed.base.validation_message import validation_message
from tulip_testbed.measurements.bounds import (
    LEAST_CELL_SPREAD,
    MOST_ACCELERATION,
    MOST_ANGLE,
    MOST_FORCE,
    MOST_FORCE_ACCELERATION,
    MOST_LENGTH,
    MOST_SPEED,
)
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.measurements.contact_entries import wrong_contacts
from tulip_testbed.measurements.contacts import Contacts
from tulip_testbed.measurements.data import OF_WRENCHES, Measurements, feet_in_contact, vertical_forces
from tulip_testbed.measurements.header import SensorSheet
from tulip_testbed.measurements.manifest import RobotEntry, manifest_of
from tulip_testbed.measurements.manipulations import Experiment
from tulip_testbed.measurements.stated_convention import StatedConvention

WHOLE = ("posture", "placement")  # columns of whole numbers
SUPPORTS = ("double", "right", "left")
MOST_TIME = 1e10  # s
LEAST_WEIGHT = 1.0  # N, on all cells or wrench sensors together
# Narrower than what can be read, so that the preflight can say which unit was probably meant.
LIKELY_ANGLE, LIKELY_LENGTH = 2 * np.pi, 20.0  # rad, m
LIKELY_SENSORS = {  # s.d. and resolutions of a data sheet [rad, N, m or rad]
    "encoder_sd": 0.2,
    "encoder_resolution": 0.2,
    "cell_sd": 1e3,
    "cell_resolution": 1e3,
    "placement_sd": 1.0,
}
LIKELY_LEVER = 2.0  # m, of the weight about the origin of a wrench sensor
SAME_WINDOW = 1e-6  # s
LIKELY_REPEAT = 0.2  # rad, between the angles of a posture that is measured again


class Rule(NamedTuple):
    """Bounds of a column; `likely`: of the size; `gaps`: NaN means unknown."""

    low: float
    high: float
    likely: float = np.inf
    gaps: bool = False


ANGLE = Rule(-MOST_ANGLE, MOST_ANGLE, LIKELY_ANGLE)
LENGTH = Rule(-MOST_LENGTH, MOST_LENGTH, LIKELY_LENGTH)
RULES = {  # by the first word of a column's name
    "time": Rule(-MOST_TIME, MOST_TIME, gaps=True),
    "window": Rule(0.0, MOST_TIME, gaps=True),
    "samples": Rule(1.0, MOST_TIME, gaps=True),
    "q": ANGLE,
    "q_std": Rule(0.0, MOST_ANGLE, gaps=True),
    "q_command": ANGLE,
    "motor": ANGLE,
    "q_rate": Rule(-MOST_SPEED, MOST_SPEED),
    "q_acceleration": Rule(-MOST_ACCELERATION, MOST_ACCELERATION),
    "cell": Rule(-MOST_FORCE, MOST_FORCE),
    "cell_std": Rule(0.0, MOST_FORCE, gaps=True),
    "wrench": Rule(-MOST_FORCE, MOST_FORCE, gaps=True),
    "wrench_std": Rule(0.0, MOST_FORCE, gaps=True),
    "wrench_rate": Rule(-MOST_FORCE_ACCELERATION, MOST_FORCE_ACCELERATION, gaps=True),
    "wrench_acceleration": Rule(-MOST_FORCE_ACCELERATION, MOST_FORCE_ACCELERATION, gaps=True),
    "wrench_jerk": Rule(-MOST_FORCE_ACCELERATION, MOST_FORCE_ACCELERATION, gaps=True),
    "speed": Rule(0.0, MOST_SPEED, gaps=True),
    "acceleration": Rule(-MOST_ACCELERATION, MOST_ACCELERATION, gaps=True),
}


OF_HEADER: dict[str, Any] = {
    **dict.fromkeys(("gains", "tolerances", "constant_joints"), Mapping),
    "conventions": tuple[StatedConvention, ...],
    "experiments": tuple[Experiment, ...],
}


def check_contract(
    measurements: Measurements,
    table: Path | str = "measurements",
    manifest: Path | str = "measurements",
    likely: bool = True,
) -> None:
    """Refuse measurements that break the contract, or are not `likely`: as if in degrees or millimetres."""
    m = measurements
    _check_shapes(m, str(table))
    _check_constants(m, str(table))
    try:
        manifest_of(m, {})
    except ValidationError as error:
        raise InputError(f"{manifest}: {validation_message(error)}") from None
    if m.contacts is None:
        _check_plates(m, str(manifest))
    for joint in m.gains:
        look_up("joint", joint, m.joints, f"{manifest}: key 'gains'")
    ruled = ((name, values, _rule(name)) for name, values in m.columns().items())
    columns = {name: (values, rule) for name, values, rule in ruled if rule is not None}
    for name, (values, rule) in columns.items():
        finite = np.isfinite(values) | (np.isnan(values) & rule.gaps)  # of wrenches, see `_check_present`
        refuse_rows(table, name, ~finite, values, "a finite number")
        outside = (values < rule.low) | (values > rule.high)
        refuse_rows(table, name, outside, values, f"a number within [{rule.low:g}, {rule.high:g}]")
    if m.contacts is not None:
        _check_present(m, str(table))
    _check_rows(m, str(table))
    _check_motion(m, str(table))
    if not likely:
        return
    for name, (values, rule) in columns.items():
        expected = f"a number within [{-rule.likely:g}, {rule.likely:g}] (rad, m)"
        refuse_rows(table, name, np.abs(values) > rule.likely, values, expected)
    if m.contacts is not None and np.isfinite(m.contacts.zero_sd).all():
        _check_moments(m, m.contacts, str(table))
    _check_sensors(m, str(manifest))
    _check_repeats(m, str(table))


def _rule(name: str) -> Rule | None:
    first, _, rest = name.partition(".")
    if first == "plate":
        return ANGLE if rest.endswith(".yaw") else LENGTH
    return RULES.get(first)


def _check_shapes(m: Measurements, where: str) -> None:
    """Refuse fields of another type or shape than the contract's; a folder's reader makes no such ones."""
    if not isinstance(m.joints, tuple) or not all(isinstance(joint, str) for joint in m.joints):
        raise InputError(f"{where}: joints: found {shortened(m.joints)}, expected a tuple of names")
    if not isinstance(m.sensors, SensorSheet):
        raise InputError(f"{where}: sensors: found {shortened(m.sensors)}, expected a SensorSheet")
    keys = tuple(RobotEntry.model_fields)
    if not isinstance(m.robot, dict) or any(key not in m.robot for key in keys):
        raise InputError(f"{where}: robot: found {shortened(m.robot)}, expected the keys {', '.join(keys)}")
    for name, kind in OF_HEADER.items():
        expect(f"{where}: {name}", getattr(m, name), kind)
    if m.contacts is not None:
        wrong = (
            wrong_contacts(m.contacts) if isinstance(m.contacts, Contacts) else "expected Contacts or None"
        )
        if wrong:
            raise InputError(f"{where}: contacts: {wrong}")
    if wrong := m.wrong_shape():
        raise InputError(f"{where}: {wrong}")
    if not len(m):
        raise InputError(f"{where}: found no rows, expected one per posture")
    refuse_rows(where, "support", ~np.isin(m.support, SUPPORTS), m.support, f"one of {', '.join(SUPPORTS)}")


def _check_constants(m: Measurements, where: str) -> None:
    """Refuse constant joints that are unknown or move, and places of sensors that are in the feet."""
    constant = m.constant_joints if isinstance(m.constant_joints, Mapping) else ()
    for joint in constant:
        look_up("joint", joint, m.joints, f"{where}: constant_joints")
        angles = m.joint_angles[:, m.joints.index(joint)]
        refuse_rows(
            where, f"q.{joint}", angles != angles[0], angles, f"{angles[0]}, as in row 1 (it is constant)"
        )
    if m.contacts is not None and m.contacts.mount == "foot":
        for name in ("plate_poses", "top_height"):
            if np.any(getattr(m, name)):
                raise InputError(
                    f"{where}: {name}: found other than zeros, expected zeros: sensors are in the feet"
                )
    for name in OF_WRENCHES.values():
        if m.contacts is None and getattr(m, name) is not None:
            raise InputError(f"{where}: {name}: found readings without contacts, expected None")


def _check_plates(m: Measurements, where: str) -> None:
    """Refuse a plate whose cells lie on one line, since it has no centre of pressure."""
    for plate, cells in zip(PLATES, m.cells, strict=True):
        if np.linalg.svd(cells - cells.mean(axis=0), compute_uv=False)[1] < 2 * LEAST_CELL_SPREAD:
            raise InputError(
                f"{where}: key 'plates.{plate}.cells': found cells on one line, "
                "expected four that span an area"
            )


def _check_present(m: Measurements, where: str) -> None:
    """Refuse readings of a wrench sensor that are absent, but for a foot in the air."""
    assert m.contacts is not None
    assert m.wrenches is not None
    gaps, stands = np.isnan(m.wrenches), feet_in_contact(m.support)
    for p, side in enumerate(PLATES):
        whole = gaps[:, p].all(axis=1) & ~stands[:, p]
        for k, channel in enumerate(m.contacts.channels):
            name = f"wrench.{side}.{channel}"
            missing = gaps[:, p, k] & ~whole
            refuse_rows(
                where, name, missing, m.wrenches[:, p, k], "a number (or, in the air, none of the contact)"
            )


def _check_moments(m: Measurements, contacts: Contacts, where: str) -> None:
    """Refuse moments that the weight could not have with any lever of a foot: newton millimetres."""
    assert m.wrenches is not None
    down = np.abs(vertical_forces(m)).sum(axis=1)
    for k, channel in enumerate(contacts.channels):
        if channel.startswith("m"):
            for p, side in enumerate(PLATES):
                values = m.wrenches[:, p, k]
                expected = f"a moment within {LIKELY_LEVER:g} m times the weight [Nm]"
                refuse_rows(
                    where, f"wrench.{side}.{channel}", np.abs(values) > LIKELY_LEVER * down, values, expected
                )


def _check_rows(m: Measurements, where: str) -> None:
    """Refuse rows without weight, and rows that occur twice."""
    if m.contacts is None:
        forces, name = m.cell_forces, "cell.*"
    else:
        forces, name = vertical_forces(m), "wrench.*.fz"
    total = forces.sum(axis=1)
    light = total < np.maximum(LEAST_WEIGHT, 1e-2 * np.abs(forces).sum(axis=1))
    if m.contacts is None or np.isfinite(m.contacts.zero_sd).all():
        refuse_rows(where, name, light, total, "the robot's weight as their sum [N]")
    _, first = np.unique(np.column_stack([m.posture, m.time]), axis=0, return_index=True)
    again = np.isfinite(m.time) & ~np.isin(np.arange(len(m)), first)
    refuse_rows(where, "posture", again, m.posture, "another posture or another time than a row before")


def _check_motion(m: Measurements, where: str) -> None:
    """Refuse rates without accelerations, and rows of moving feet on plates with no place in time.

    The noise of such rows lasts; how they share it follows from their times and the length of a window.
    """
    given = {"q_rate": m.joint_rates, "q_acceleration": m.joint_accelerations}
    there = [name for name, values in given.items() if values is not None]
    if len(there) == 1:
        raise InputError(f"{where}: found {there[0]} alone, expected {' and '.join(given)}, or neither")
    if there and m.on_plates:
        refuse_rows(where, "time", ~np.isfinite(m.time), m.time, "a finite number: the robot moves")
        again = np.isin(np.arange(len(m)), np.unique(m.time, return_index=True)[1], invert=True)
        refuse_rows(where, "time", again, m.time, "another time than a row before: the robot moves")
        other = ~(m.window > 0) | (np.abs(m.window - m.window[0]) > SAME_WINDOW)
        refuse_rows(where, "window", other, m.window, "one length [s] in all rows: the robot moves")


def _check_sensors(m: Measurements, where: str) -> None:
    """Refuse errors of sensors that no sensor has."""
    for key, value in dataclasses.asdict(m.sensors).items():
        most = LIKELY_SENSORS[key]
        if value is not None and np.max(value) > most:
            raise InputError(
                f"{where}: key 'sensors.{key}': found {shortened(value)}, "
                f"expected {most:g} or less (rad, N, m)"
            )


def _check_repeats(m: Measurements, where: str) -> None:
    """Refuse one number for different postures of several placements, as if each counted again."""
    _, first, number = np.unique(m.posture, return_index=True, return_inverse=True)
    off = np.abs(m.joint_angles - m.joint_angles[first[number]])
    elsewhere = m.placement != m.placement[first[number]]
    if (other := elsewhere & (off.max(axis=1) > LIKELY_REPEAT)).any():
        row = int(other.argmax())
        joint = m.joints[int(off[row].argmax())]
        raise InputError(
            f"{where}: column 'posture', row {row + 1}: found number {m.posture[row]} again, with "
            f"q.{joint} {off[row].max():.2g} rad from row {first[number[row]] + 1}; expected a number of its "
            "own for every posture"
        )
