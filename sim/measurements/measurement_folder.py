"""The measurement folder: manifest.json beside postures.parquet (or .csv)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from sim.errors import InputError
from sim.measurements.data import Measurements, SensorSheet
from sim.measurements.tables import (
    Columns,
    Table,
    find_table,
    new_folder,
    read_json,
    software,
    write_json,
    write_table,
)
from sim.model import CELLS, CORNERS, PLATES, sha256

SUPPORTS = ("double", "right", "left")
Point = tuple[FiniteFloat, FiniteFloat]
Positive = Annotated[FiniteFloat, Field(gt=0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0)]


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
    top_height: FiniteFloat


class PlatesEntry(_Strict):
    right: PlateEntry
    left: PlateEntry


class MassEntry(_Strict):
    value: Positive
    sd: NotNegative


class SensorsEntry(_Strict):
    encoder_sd: NotNegative | None
    encoder_resolution: NotNegative | None
    cell_sd: NotNegative | None
    cell_resolution: NotNegative | None
    placement_sd: tuple[NotNegative, NotNegative, NotNegative] | None


class Manifest(_Strict):
    """manifest.json, as the contract lists it; what only a program would know may be left out."""

    format: Literal["tulip-measurements"]
    version: Literal[1]
    robot: RobotEntry
    joints: list[str] = Field(min_length=1)
    plates: PlatesEntry
    weighed_mass: MassEntry | None
    gravity: Positive
    sensors: SensorsEntry
    created: str | None = None
    software: dict[str, str] | None = None
    tables: dict[str, str | None] | None = None


def write_measurements(folder: Path, measurements: Measurements) -> None:
    """Write a measurement folder; it appears whole or not at all.

    Raises:
        InputError: the folder exists or cannot be written.
    """
    with new_folder(folder) as working:
        paths = write_table(working, "postures", _columns(measurements))
        tables = {path.name: sha256(path) for path in paths.values()}
        write_json(working / "manifest.json", _manifest(measurements, tables).model_dump())


def read_measurements(folder: Path) -> Measurements:
    """Read and check a measurement folder.

    Raises:
        InputError: the folder breaks the contract; the message names file, place, what was
            found and what was expected.
    """
    manifest = read_manifest(folder)
    return _measurements(manifest, Table(checked_table(folder, "postures", manifest.tables)))


def read_manifest(folder: Path) -> Manifest:
    """Read and check a measurement folder's manifest.json.

    Raises:
        InputError: no such folder, or a manifest that breaks the contract.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such measurement folder")
    where = folder / "manifest.json"
    try:
        return Manifest.model_validate(read_json(where))
    except ValidationError as error:
        raise InputError(f"{where}: {validation_message(error)}") from None


def checked_table(folder: Path, name: str, tables: Mapping[str, str | None] | None) -> Path:
    """The table to read, intact where the manifest gives its hash.

    Nobody can say which of two tables is meant, unless both are what the manifest lists.

    Raises:
        InputError: no table, one that is not what the manifest lists, or two without their hashes.
    """
    path = find_table(folder, name)
    hashes = tables or {}
    present = [twin for twin in (folder / f"{name}.parquet", folder / f"{name}.csv") if twin.is_file()]
    for twin in present:
        expected = hashes.get(twin.name)
        if expected is not None:
            check_hash(twin, expected)
        elif len(present) > 1:
            raise InputError(
                f"{twin}: found beside {path.name if twin != path else present[1].name} and without a sha256 "
                "in the manifest's 'tables', expected one of the two tables or both hashes"
            )
    return path


def check_hash(path: Path, expected: str) -> None:
    """Compare a table's bytes with the manifest that lists it.

    Raises:
        InputError: another hash.
    """
    if (found := sha256(path)) != expected.lower():
        raise InputError(
            f"{path}: hash mismatch: found sha256 {found[:12]}..., "
            f"expected {expected[:12]}... by the manifest"
        )


def validation_message(error: ValidationError) -> str:
    """The first complaint of pydantic in one line."""
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    found = "nothing" if first["type"] == "missing" else repr(first["input"])[:60]
    return f"key '{place}': found {found}; {first['msg']}"


def _columns(measurements: Measurements) -> Columns:
    m = measurements
    columns: Columns = {
        "posture": m.posture,
        "placement": m.placement,
        "support": m.support,
        "time": m.time,
        "window": m.window,
        "samples": m.samples,
    }
    for prefix, names, values in (
        ("q", m.joints, m.joint_angles),
        ("q_std", m.joints, m.joint_angles_sd),
        ("q_command", m.joints, m.command),
        ("motor", m.joints, m.motor),
        ("cell", CELLS, m.cell_forces),
        ("cell_std", CELLS, m.cell_forces_sd),
    ):
        if values is not None:
            columns |= {f"{prefix}.{name}": values[:, k] for k, name in enumerate(names)}
    for p, plate in enumerate(PLATES):
        for k, axis in enumerate(("x", "y", "yaw")):
            columns[f"plate.{plate}.{axis}"] = m.plate_poses[:, p, k]
    return columns


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
    return Manifest.model_validate(
        {
            "format": "tulip-measurements",
            "version": 1,
            "robot": m.robot,
            "joints": list(m.joints),
            "plates": plates,
            "weighed_mass": mass,
            "gravity": m.gravity,
            "sensors": dataclasses.asdict(m.sensors),
            "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "software": software(),
            "tables": tables,
        }
    )


def _measurements(manifest: Manifest, table: Table) -> Measurements:
    joints = tuple(manifest.joints)
    optional = {
        prefix: table.matrix(prefix, joints) if table.has(f"{prefix}.{joints[0]}") else None
        for prefix in ("q_command", "motor")
    }
    plates = [manifest.plates.right, manifest.plates.left]
    mass, sheet = manifest.weighed_mass, manifest.sensors
    return Measurements(
        joints=joints,
        posture=table.integers("posture"),
        placement=table.integers("placement"),
        support=(
            table.texts("support", SUPPORTS) if table.has("support") else np.full(len(table), SUPPORTS[0])
        ),
        time=table.numbers("time", missing_allowed=True),
        window=table.numbers("window", missing_allowed=True),
        samples=table.numbers("samples", missing_allowed=True),
        joint_angles=table.matrix("q", joints),
        joint_angles_sd=table.matrix("q_std", joints, missing_allowed=True),
        command=optional["q_command"],
        motor=optional["motor"],
        cell_forces=table.matrix("cell", CELLS),
        cell_forces_sd=table.matrix("cell_std", CELLS, missing_allowed=True),
        plate_poses=np.stack([table.matrix(f"plate.{plate}", ("x", "y", "yaw")) for plate in PLATES], axis=1),
        cells=np.array([[getattr(plate.cells, corner) for corner in CORNERS] for plate in plates]),
        top_height=np.array([plate.top_height for plate in plates]),
        weighed_mass=None if mass is None else (mass.value, mass.sd),
        gravity=manifest.gravity,
        sensors=SensorSheet(**{f.name: getattr(sheet, f.name) for f in dataclasses.fields(SensorSheet)}),
        robot={key: getattr(manifest.robot, key) for key in ("model", "sha256", "stance_foot", "swing_foot")},
    )
