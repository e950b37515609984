"""The contract of measurements: what every row and every figure has to be, in a folder as in memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from tulip_testbed.sim.errors import InputError, look_up, shortened
from tulip_testbed.sim.measurements.data import Measurements, SensorSheet
from tulip_testbed.sim.measurements.manifest import (
    MOST_ANGLE,
    MOST_FORCE,
    MOST_LENGTH,
    RobotEntry,
    manifest_of,
)
from tulip_testbed.sim.robot import CELLS, PLATES
from tulip_testbed.sim.validation_message import validation_message

WHOLE = ("posture", "placement")  # columns of whole numbers
SUPPORTS = ("double", "right", "left")
MOST_TIME = 1e10  # s
LEAST_WEIGHT = 1.0  # N, on the eight cells together
LEAST_CELL_SPREAD = 1e-3  # m, r.m.s. of a plate's cells about their best line
# Narrower than what can be read, so that the preflight can say which unit was probably meant.
LIKELY_ANGLE, LIKELY_LENGTH = 2 * np.pi, 20.0  # rad, m
LIKELY_SENSORS = {  # s.d. and resolutions of a data sheet [rad, N, m or rad]
    "encoder_sd": 0.2,
    "encoder_resolution": 0.2,
    "cell_sd": 1e3,
    "cell_resolution": 1e3,
    "placement_sd": 1.0,
}
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
    "cell": Rule(-MOST_FORCE, MOST_FORCE),
    "cell_std": Rule(0.0, MOST_FORCE, gaps=True),
}


def check_contract(
    measurements: Measurements,
    table: Path | str = "measurements",
    manifest: Path | str = "measurements",
    likely: bool = True,
) -> None:
    """Refuse measurements that break the contract, wherever they come from.

    Args:
        table, manifest: where rows and figures come from, for messages.
        likely: refuse implausible figures as well, which suggest degrees or millimetres.

    Raises:
        InputError: names place, what was found and what was expected.
    """
    m = measurements
    _check_shapes(m, str(table))
    try:
        manifest_of(m, {})
    except ValidationError as error:
        raise InputError(f"{manifest}: {validation_message(error)}") from None
    _check_plates(m, str(manifest))
    for joint in m.gains:
        look_up("joint", joint, m.joints, f"{manifest}: key 'gains'")
    ruled = ((name, values, _rule(name)) for name, values in m.columns().items())
    columns = {name: (values, rule) for name, values, rule in ruled if rule is not None}
    for name, (values, rule) in columns.items():
        finite = np.isfinite(values) | (np.isnan(values) & rule.gaps)
        _refuse(str(table), name, ~finite, values, "a finite number")
        outside = (values < rule.low) | (values > rule.high)
        _refuse(str(table), name, outside, values, f"a number within [{rule.low:g}, {rule.high:g}]")
    _check_rows(m, str(table))
    if not likely:
        return
    for name, (values, rule) in columns.items():
        expected = f"a number within [{-rule.likely:g}, {rule.likely:g}] (rad, m)"
        _refuse(str(table), name, np.abs(values) > rule.likely, values, expected)
    _check_sensors(m, str(manifest))
    _check_repeats(m, str(table))


def _rule(name: str) -> Rule | None:
    first, _, rest = name.partition(".")
    if first == "plate":
        return ANGLE if rest.endswith(".yaw") else LENGTH
    return RULES.get(first)


def _refuse(where: str, name: str, rows: np.ndarray, values: np.ndarray, expected: str) -> None:
    """Refuse the first of the rows where `rows`, (m,), is true."""
    if rows.any():
        row = int(rows.argmax())
        raise InputError(f"{where}: column '{name}', row {row + 1}: found {values[row]}, expected {expected}")


def _check_shapes(m: Measurements, where: str) -> None:
    """Refuse fields of another type or shape than the contract's; a folder's reader makes no such ones."""
    if not isinstance(m.joints, tuple) or not all(isinstance(joint, str) for joint in m.joints):
        raise InputError(f"{where}: joints: found {shortened(m.joints)}, expected a tuple of names")
    if not isinstance(m.sensors, SensorSheet):
        raise InputError(f"{where}: sensors: found {shortened(m.sensors)}, expected a SensorSheet")
    keys = tuple(RobotEntry.model_fields)
    if not isinstance(m.robot, dict) or any(key not in m.robot for key in keys):
        raise InputError(f"{where}: robot: found {shortened(m.robot)}, expected the keys {', '.join(keys)}")
    rows = m.posture.shape if isinstance(m.posture, np.ndarray) and m.posture.ndim == 1 else ("rows",)
    for name, kinds, shape in _shapes(m, rows):
        found = getattr(m, name)
        if not isinstance(found, np.ndarray) or found.dtype.kind not in kinds or found.shape != shape:
            seen = f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
            size = ", ".join(map(str, shape))
            raise InputError(f"{where}: {name}: found {seen}, expected an array of {KINDS[kinds]} ({size})")
    if not len(m):
        raise InputError(f"{where}: found no rows, expected one per posture")
    _refuse(where, "support", ~np.isin(m.support, SUPPORTS), m.support, f"one of {', '.join(SUPPORTS)}")


KINDS = {"iu": "whole numbers", "iuf": "numbers", "U": "texts"}


def _shapes(m: Measurements, rows: tuple) -> Iterator[tuple[str, str, tuple]]:
    """Yield name, kinds of numbers and shape of every array."""
    for name in WHOLE:
        yield name, "iu", rows
    yield "support", "U", rows
    for name in ("time", "window", "samples"):
        yield name, "iuf", rows
    for name in ("joint_angles", "joint_angles_sd", "command", "motor"):
        if getattr(m, name) is not None or name.startswith("joint"):
            yield name, "iuf", (*rows, len(m.joints))
    for name in ("cell_forces", "cell_forces_sd"):
        yield name, "iuf", (*rows, len(CELLS))
    yield "plate_poses", "iuf", (*rows, len(PLATES), 3)
    yield "cells", "iuf", (len(PLATES), len(CELLS) // len(PLATES), 2)
    yield "top_height", "iuf", (len(PLATES),)


def _check_plates(m: Measurements, where: str) -> None:
    """Refuse a plate whose cells lie on one line, since it has no centre of pressure."""
    for plate, cells in zip(PLATES, m.cells, strict=True):
        if np.linalg.svd(cells - cells.mean(axis=0), compute_uv=False)[1] < 2 * LEAST_CELL_SPREAD:
            raise InputError(
                f"{where}: key 'plates.{plate}.cells': found cells on one line, "
                "expected four that span an area"
            )


def _check_rows(m: Measurements, where: str) -> None:
    """Refuse rows without weight, and rows that occur twice."""
    total = m.cell_forces.sum(axis=1)
    light = total < np.maximum(LEAST_WEIGHT, 1e-2 * np.abs(m.cell_forces).sum(axis=1))
    _refuse(where, "cell.*", light, total, "the robot's weight as their sum [N]")
    _, first = np.unique(np.column_stack([m.posture, m.time]), axis=0, return_index=True)
    again = np.isfinite(m.time) & ~np.isin(np.arange(len(m)), first)
    _refuse(where, "posture", again, m.posture, "another posture or another time than a row before")


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
    """Refuse one number for different postures of several placements, as if each counted anew."""
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
