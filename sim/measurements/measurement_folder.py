"""The measurement folder: manifest.json and postures.parquet (or .csv)."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError

from tulip_testbed.sim.errors import IncompleteError, InputError
from tulip_testbed.sim.files import new_folder, present
from tulip_testbed.sim.measurements.data import Measurements, SensorSheet
from tulip_testbed.sim.measurements.folder_kind import check_kind
from tulip_testbed.sim.measurements.table_files import (
    Table,
    checked_table,
    read_json,
    software,
    tables_beside,
    write_json,
    write_table,
)
from tulip_testbed.sim.robot import CELLS, CORNERS, PLATES, sha256
from tulip_testbed.sim.validation_message import validation_message

WHOLE = ("posture", "placement")  # columns of whole numbers
MAY_LACK = ("support", "time", "window", "samples", "q_std", "q_command", "motor", "cell_std")
SUPPORTS = ("double", "right", "left")

# Bounds beyond any laboratory: narrow enough that nothing overflows later, wide enough that the preflight
# can still recognise degrees instead of radians and millimetres instead of metres.
MOST_ANGLE = 1e3  # rad
MOST_LENGTH = 1e4  # m, from the base frame to a plate and from a plate to a cell
LIKELY_ANGLE, LIKELY_LENGTH = 2 * np.pi, 20.0  # rad, m
MOST_FORCE = 1e5  # N, on a cell
MOST_TIME = 1e10  # s
LEAST_WEIGHT = 1.0  # N, on the eight cells together
LEAST_CELL_SPREAD = 1e-3  # m, r.m.s. of a plate's cells about their best line
LEAST_GRAVITY, MOST_GRAVITY = 0.1, 100.0  # m/s2
LEAST_MASS = 1e-3  # kg
LEAST_DEVIATION = 1e-12  # rad, N, m, kg: smaller ones vanish when squared or make a quotient overflow


def _not_tiny(deviation: float) -> float:
    if 0 < deviation < LEAST_DEVIATION:
        raise ValueError(f"expected 0 or at least {LEAST_DEVIATION:g}")
    return deviation


Length = Annotated[float, Strict(), Field(ge=-MOST_LENGTH, le=MOST_LENGTH)]
Point = tuple[Length, Length]
Gravity = Annotated[float, Strict(), Field(ge=LEAST_GRAVITY, le=MOST_GRAVITY)]
Mass = Annotated[float, Strict(), Field(ge=LEAST_MASS, le=MOST_FORCE)]
Deviation = Annotated[float, Strict(), Field(ge=0, le=MOST_FORCE), AfterValidator(_not_tiny)]
Version = Annotated[int, Strict(), Field(ge=1, le=1)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="allow")


class RobotEntry(_Strict):
    model: str
    sha256: str | None = None
    stance_foot: str
    swing_foot: str


class CellEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    front_left: Point
    front_right: Point
    rear_right: Point
    rear_left: Point


class PlateEntry(_Strict):
    cells: CellEntry
    top_height: Length


class PlatesEntry(_Strict):
    right: PlateEntry
    left: PlateEntry


class MassEntry(_Strict):
    value: Mass
    sd: Deviation


class SensorsEntry(_Strict):
    encoder_sd: Deviation | None
    encoder_resolution: Deviation | None
    cell_sd: Deviation | None
    cell_resolution: Deviation | None
    placement_sd: tuple[Deviation, Deviation, Deviation] | None


class Manifest(_Strict):
    """Content of manifest.json; entries that only software knows are optional."""

    format: Literal["tulip-measurements"]
    version: Version
    robot: RobotEntry
    joints: list[str] = Field(min_length=1)
    plates: PlatesEntry
    weighed_mass: MassEntry | None
    gravity: Gravity
    sensors: SensorsEntry
    tolerances: dict[str, Deviation] | None = None
    created: str | None = None
    software: dict[str, str] | None = None
    tables: dict[str, str | None] | None = None


def required_columns(joints: tuple[str, ...]) -> tuple[str, ...]:
    """List the columns without which a posture cannot be used."""
    poses = [f"plate.{plate}.{axis}" for plate in PLATES for axis in ("x", "y", "yaw")]
    return (*WHOLE, *(f"q.{joint}" for joint in joints), *(f"cell.{cell}" for cell in CELLS), *poses)


def write_measurements(folder: Path, measurements: Measurements) -> None:
    """Write a measurement folder, which appears whole or not at all.

    Raises:
        InputError: the folder exists or cannot be written, or measurements that no folder may hold.
    """
    with new_folder(folder) as working:
        paths = write_table(working, "postures", measurements.columns())
        tables = {path.name: sha256(path) for path in paths.values()}
        unset = None if measurements.tolerances else {"tolerances"}
        write_json(working / "manifest.json", _manifest(measurements, tables).model_dump(exclude=unset))


def read_measurements(folder: Path, likely: bool = True) -> Measurements:
    """Read and check a measurement folder.

    Args:
        likely: refuse implausible angles and lengths, which suggest degrees or millimetres.

    Raises:
        InputError: the folder breaks the contract; the message names file, place, what was
            found and what was expected.
    """
    folder = Path(folder)
    try:
        manifest = read_manifest(folder)
        table = checked_table(folder, "postures", manifest.tables)
        table.require(required_columns(tuple(manifest.joints)), MAY_LACK)
    except IncompleteError as error:
        raise InputError(f"{error}; `tt.check({str(folder)!r})` lists all that is missing or wrong") from None
    measurements = _measurements(manifest, table)
    _check_plates(folder / "manifest.json", measurements)
    _check_rows(table, measurements)
    if likely:
        _check_units(table, measurements)
    return measurements


def read_manifest(folder: Path) -> Manifest:
    """Read and check a measurement folder's manifest.json.

    Raises:
        InputError: the folder is missing, or the manifest breaks the contract.
    """
    folder = Path(folder)
    check_kind(folder, "measurement")
    where = folder / "manifest.json"
    if not present(where):
        raise IncompleteError(f"{where}: missing{tables_beside(folder)}")
    try:
        return Manifest.model_validate(read_json(where))
    except ValidationError as error:
        raise IncompleteError(f"{where}: {validation_message(error)}") from None


def _check_plates(where: Path, measurements: Measurements) -> None:
    """Refuse a plate whose cells lie on one line, since it has no centre of pressure."""
    for plate, cells in zip(PLATES, measurements.cells, strict=True):
        if np.linalg.svd(cells - cells.mean(axis=0), compute_uv=False)[1] < 2 * LEAST_CELL_SPREAD:
            raise InputError(
                f"{where}: key 'plates.{plate}.cells': found cells on one line, "
                "expected four that span an area"
            )


def _check_units(table: Table, m: Measurements) -> None:
    poses = {f"plate.{plate}": m.plate_poses[:, k] for k, plate in enumerate(PLATES)}
    columns = [(f"q.{joint}", m.joint_angles[:, k], LIKELY_ANGLE) for k, joint in enumerate(m.joints)]
    for plate, pose in poses.items():
        for k, (axis, most) in enumerate((("x", LIKELY_LENGTH), ("y", LIKELY_LENGTH), ("yaw", LIKELY_ANGLE))):
            columns.append((f"{plate}.{axis}", pose[:, k], most))
    for name, values, most in columns:
        expected = f"a number within [{-most:g}, {most:g}] (rad, m)"
        table.refuse(name, np.abs(values) > most, values, expected)


def _check_rows(table: Table, measurements: Measurements) -> None:
    """Refuse rows without weight, and rows that occur twice."""
    forces = measurements.cell_forces
    total = forces.sum(axis=1)
    light = total < np.maximum(LEAST_WEIGHT, 1e-2 * np.abs(forces).sum(axis=1))
    table.refuse("cell.*", light, total, "the robot's weight as their sum [N]")
    _, first = np.unique(
        np.column_stack([measurements.posture, measurements.time]), axis=0, return_index=True
    )
    again = np.isfinite(measurements.time) & ~np.isin(np.arange(len(measurements)), first)
    table.refuse("posture", again, measurements.posture, "another posture or another time than a row before")


def _manifest(measurements: Measurements, tables: dict[str, str]) -> Manifest:
    m = measurements
    plates = {
        plate: {
            "cells": dict(zip(CORNERS, m.cells[p].tolist(), strict=True)),
            "top_height": float(m.top_height[p]),
        }
        for p, plate in enumerate(PLATES)
    }
    mass = None if m.weighed_mass is None else {"value": m.weighed_mass[0], "sd": m.weighed_mass[1]}
    content = {
        "format": "tulip-measurements",
        "version": 1,
        "robot": m.robot,
        "joints": list(m.joints),
        "plates": plates,
        "weighed_mass": mass,
        "gravity": m.gravity,
        "sensors": dataclasses.asdict(m.sensors),
        "tolerances": dict(m.tolerances),
        "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "software": software(),
        "tables": tables,
    }
    try:
        return Manifest.model_validate(content)
    except ValidationError as error:
        raise InputError(f"measurements: {validation_message(error)}") from None


def _measurements(manifest: Manifest, table: Table) -> Measurements:
    joints = tuple(manifest.joints)
    angle, length = {"low": -MOST_ANGLE, "high": MOST_ANGLE}, {"low": -MOST_LENGTH, "high": MOST_LENGTH}
    optional = {
        prefix: table.matrix(prefix, joints, **angle)
        if any(table.has(f"{prefix}.{joint}") for joint in joints)
        else None
        for prefix in ("q_command", "motor")
    }
    plates = [manifest.plates.right, manifest.plates.left]
    poses = [
        np.column_stack(
            [table.matrix(f"plate.{p}", ("x", "y"), **length), table.numbers(f"plate.{p}.yaw", **angle)]
        )
        for p in PLATES
    ]
    mass, sheet = manifest.weighed_mass, manifest.sensors
    return Measurements(
        joints=joints,
        posture=table.integers("posture"),
        placement=table.integers("placement"),
        support=(
            table.texts("support", SUPPORTS) if table.has("support") else np.full(len(table), SUPPORTS[0])
        ),
        time=table.numbers("time", True, -MOST_TIME, MOST_TIME),
        window=table.numbers("window", True, 0.0, MOST_TIME),
        samples=table.numbers("samples", True, 1.0, MOST_TIME),
        joint_angles=table.matrix("q", joints, **angle),
        joint_angles_sd=table.matrix("q_std", joints, True, 0.0, MOST_ANGLE),
        command=optional["q_command"],
        motor=optional["motor"],
        cell_forces=table.matrix("cell", CELLS, False, -MOST_FORCE, MOST_FORCE),
        cell_forces_sd=table.matrix("cell_std", CELLS, True, 0.0, MOST_FORCE),
        plate_poses=np.stack(poses, axis=1),
        cells=np.array([[getattr(plate.cells, corner) for corner in CORNERS] for plate in plates]),
        top_height=np.array([plate.top_height for plate in plates]),
        weighed_mass=None if mass is None else (mass.value, mass.sd),
        gravity=manifest.gravity,
        sensors=SensorSheet(**{f.name: getattr(sheet, f.name) for f in dataclasses.fields(SensorSheet)}),
        robot={key: getattr(manifest.robot, key) for key in ("model", "sha256", "stance_foot", "swing_foot")},
        tolerances=manifest.tolerances or {},
    )
