"""The measurement folder: manifest.json and postures.parquet (or .csv)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from tulip_testbed.sim.errors import IncompleteError, InputError
from tulip_testbed.sim.files import new_folder, present
from tulip_testbed.sim.measurements.checked_table import checked_table, tables_beside
from tulip_testbed.sim.measurements.contract import SUPPORTS, WHOLE, check_contract
from tulip_testbed.sim.measurements.data import Measurements, SensorSheet
from tulip_testbed.sim.measurements.folder_kind import check_kind
from tulip_testbed.sim.measurements.manifest import Manifest, manifest_of
from tulip_testbed.sim.measurements.table_files import (
    Table,
    read_json,
    write_json,
    write_table,
)
from tulip_testbed.sim.robot import CELLS, CORNERS, PLATES, sha256
from tulip_testbed.sim.validation_message import validation_message

MAY_LACK = ("support", "time", "window", "samples", "q_std", "q_command", "motor", "cell_std")


def required_columns(joints: tuple[str, ...]) -> tuple[str, ...]:
    """List the columns without which a posture cannot be used."""
    poses = [f"plate.{plate}.{axis}" for plate in PLATES for axis in ("x", "y", "yaw")]
    return (*WHOLE, *(f"q.{joint}" for joint in joints), *(f"cell.{cell}" for cell in CELLS), *poses)


def write_measurements(folder: Path, measurements: Measurements, likely: bool = True) -> None:
    """Write a measurement folder, which appears whole or not at all.

    Args:
        likely: see `read_measurements`.

    Raises:
        InputError: the measurements break the contract, or the folder exists or cannot be written.
    """
    check_contract(measurements, likely=likely)
    with new_folder(folder) as working:
        paths = write_table(working, "postures", measurements.columns())
        tables = {path.name: sha256(path) for path in paths.values()}
        unset = {name for name in ("gains", "tolerances") if not getattr(measurements, name)}
        write_json(working / "manifest.json", manifest_of(measurements, tables).model_dump(exclude=unset))


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
    check_contract(measurements, table.path, folder / "manifest.json", likely)
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


def _measurements(manifest: Manifest, table: Table) -> Measurements:
    joints = tuple(manifest.joints)
    optional = {
        prefix: table.matrix(prefix, joints)
        if any(table.has(f"{prefix}.{joint}") for joint in joints)
        else None
        for prefix in ("q_command", "motor")
    }
    plates = [manifest.plates.right, manifest.plates.left]
    poses = [
        np.column_stack([table.matrix(f"plate.{p}", ("x", "y")), table.numbers(f"plate.{p}.yaw")])
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
        time=table.numbers("time", True),
        window=table.numbers("window", True),
        samples=table.numbers("samples", True),
        joint_angles=table.matrix("q", joints),
        joint_angles_sd=table.matrix("q_std", joints, True),
        command=optional["q_command"],
        motor=optional["motor"],
        cell_forces=table.matrix("cell", CELLS),
        cell_forces_sd=table.matrix("cell_std", CELLS, True),
        plate_poses=np.stack(poses, axis=1),
        cells=np.array([[getattr(plate.cells, corner) for corner in CORNERS] for plate in plates]),
        top_height=np.array([plate.top_height for plate in plates]),
        weighed_mass=None if mass is None else (mass.value, mass.sd),
        gravity=manifest.gravity,
        sensors=SensorSheet(**{f.name: getattr(sheet, f.name) for f in dataclasses.fields(SensorSheet)}),
        robot={key: getattr(manifest.robot, key) for key in ("model", "sha256", "stance_foot", "swing_foot")},
        gains=manifest.gains or {},
        tolerances=manifest.tolerances or {},
    )
