"""The measurement folder: manifest.json and postures.parquet (or .csv)."""

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from tulip_testbed.base.errors import IncompleteError, InputError, close_to, look_up, shortened, warn
from tulip_testbed.base.files import new_folder, present, sha256, write_text
from tulip_testbed.base.table_files import TableFile, read_json, write_json, write_parquet, write_table
from tulip_testbed.base.validation_message import validation_message
from tulip_testbed.measurements.cells import CELLS, CORNERS
from tulip_testbed.measurements.checked_table import checked_table, tables_beside
from tulip_testbed.measurements.column_mapping import MappedTable, MappingEntry, mapped_table
from tulip_testbed.measurements.contact_columns import (
    Entries,
    pose_columns,
    read_contacts,
    read_poses,
    reading_columns,
)
from tulip_testbed.measurements.contract import SUPPORTS, WHOLE, check_contract
from tulip_testbed.measurements.data import OF_JOINTS, Measurements
from tulip_testbed.measurements.folder_kind import check_kind
from tulip_testbed.measurements.header import MeasurementHeader, SensorSheet
from tulip_testbed.measurements.logs.series_reduction import reduced_motion, usual_window
from tulip_testbed.measurements.manifest import (
    ConstantEntry,
    Manifest,
    MotionEntry,
    manifest_from,
    manifest_of,
    unset_keys,
)
from tulip_testbed.measurements.manipulations import Experiment, arrangement_of
from tulip_testbed.measurements.motion_table import (
    MOST_SAMPLES,
    MOTION,
    SEGMENT,
    check_segments,
    motion_columns,
)
from tulip_testbed.measurements.stated_convention import StatedConvention

MAY_LACK = (
    *("support", "time", "window", "samples", "q_std", "q_command", "motor", "cell_std"),
    *("wrench_std", "wrench_rate", "wrench_acceleration", "wrench_jerk"),
    *("speed", "acceleration", "q_rate", "q_acceleration"),
)


OF_SENSORS = ("cells", "top_height", "contacts")  # fields of a header that contact sensors determine


def required_columns(
    joints: tuple[str, ...], contacts: Entries | None = None, constant: Collection[str] = ()
) -> tuple[str, ...]:
    """List the columns without which a posture cannot be used.

    Args:
        contacts: sensors of version 2, right and left; None: the four cells of each plate.
        constant: joints that are not logged.
    """
    angles = [f"q.{joint}" for joint in joints if joint not in constant]
    readings = [f"cell.{cell}" for cell in CELLS] if contacts is None else reading_columns(contacts)
    poses = pose_columns() if contacts is None or contacts[0].mount == "ground" else []
    return (*WHOLE, *angles, *readings, *poses)


def known_columns(manifest: Manifest) -> tuple[str, ...]:
    """List all columns that are read, those that may be left out too."""
    joints, contacts = tuple(manifest.joints), manifest.contacts
    spreads = (
        [f"cell_std.{cell}" for cell in CELLS] if contacts is None else reading_columns(contacts, "_std")
    )
    of_joints = [f"{prefix}.{joint}" for prefix in OF_JOINTS if prefix != "q" for joint in joints]
    alone = ("support", "time", "window", "samples", "speed", "acceleration")
    return (*required_columns(joints, contacts), *alone, *of_joints, *spreads)


def write_measurements(folder: Path, measurements: Measurements, likely: bool = True) -> None:
    """Write a measurement folder, which appears whole or not at all."""
    check_contract(measurements, likely=likely)
    if measurements.experiment is not None:
        raise InputError(
            f"{folder}: found {len(measurements.experiments)} experiments that were joined, expected one: "
            "write each to a folder of its own"
        )
    with new_folder(folder) as working:
        paths = write_table(working, "postures", measurements.columns())
        tables = {path.name: sha256(path) for path in paths.values()}
        manifest = manifest_of(measurements, tables).model_dump(exclude=unset_keys(measurements))
        write_json(working / "manifest.json", _without_unused(manifest))


def write_motion(folder: Path, samples: Measurements) -> None:
    """Write the folder of a motion, whole or not at all; a sample's `posture` is its segment's number."""
    check_contract(samples)
    check_segments("samples", samples.time, samples.posture, samples.placement, samples.support)
    window = usual_window(samples.sensors.encoder_resolution)
    steps = np.diff(samples.time)[np.diff(samples.posture) == 0]
    rate = float(np.round(1 / np.median(steps), 6))
    with new_folder(folder) as working:
        path = write_parquet(working, MOTION, motion_columns(samples))
        manifest = manifest_of(samples, {path.name: sha256(path)})
        manifest = manifest.model_copy(update={"motion": MotionEntry(window=window, rate=rate)})
        content = manifest.model_dump(exclude=unset_keys(samples) - {"motion"})
        write_json(working / "manifest.json", _without_unused(content))


def write_start(folder: Path, empty: Measurements) -> None:
    """Write a new folder that measurements are to be appended to: a manifest, and a table without rows.

    The table is a CSV file; the manifest states no hash, since the table is to grow.

    Args:
        empty: everything that is known beforehand, without rows.
    """
    exclude = unset_keys(empty) | {"created", "software", "tables"}
    with new_folder(folder) as working:
        manifest = manifest_of(empty, {}).model_dump(exclude=exclude)
        write_json(working / "manifest.json", _without_unused(manifest))
        write_text(working / "postures.csv", ",".join(empty.columns()) + "\n")


def _without_unused(manifest: dict[str, Any]) -> dict[str, Any]:
    """Leave the keys of a contact's mount and kind that do not apply to it out of a manifest."""
    if contacts := manifest.get("contacts"):
        unused = ("pose", "top_height", "below")
        manifest["contacts"] = [
            {key: value for key, value in entry.items() if value is not None or key not in unused}
            for entry in contacts
        ]
    return manifest


def read_measurements(folder: Path, likely: bool = True) -> Measurements:
    """Read and check a measurement folder.

    Args:
        likely: refuse implausible angles and lengths, which suggest degrees or millimetres.
    """
    folder = Path(folder)
    try:
        manifest = read_manifest(folder)
        if moves(folder):
            samples = samples_in(manifest, folder, likely)
            window = None if manifest.motion is None else manifest.motion.window
            return reduced_motion(samples, window, str(folder))
        table = checked_table(folder, "postures", manifest.tables)
        return measurements_in(manifest, table, folder / "manifest.json", likely)
    except IncompleteError as error:
        raise InputError(f"{error}; `check` lists all that is missing or wrong") from None


def moves(folder: Path) -> bool:
    """Return whether a folder holds samples of a motion in place of postures; refuse one with both."""
    motion, postures = (
        [path for path in (folder / f"{name}.{suffix}" for suffix in ("parquet", "csv")) if present(path)]
        for name in (MOTION, "postures")
    )
    if motion and postures:
        raise InputError(f"{folder}: found {motion[0].name} and {postures[0].name}, expected one of them")
    return bool(motion)


def read_samples(folder: Path, likely: bool = True) -> Measurements | None:
    """Read and check the samples of a measurement folder, as `write_motion` takes them; None: it has none."""
    return samples_in(read_manifest(folder), folder, likely) if moves(folder) else None


def samples_in(manifest: Manifest, folder: Path, likely: bool = True) -> Measurements:
    """Check the samples of a folder against its manifest and return them."""
    return samples_from(manifest, motion_table(manifest, folder), folder / "manifest.json", likely)


def samples_from(manifest: Manifest, table: MappedTable, where: Path, likely: bool = True) -> Measurements:
    """Check samples in a table against a manifest and return them.

    Args:
        where: path of the manifest, for messages. likely: see `read_measurements`.
    """
    constant = manifest.constant_joints or {}
    table.require((*required_columns(tuple(manifest.joints), manifest.contacts, constant), "time"))
    samples = rows_in(manifest, table, where)
    check_segments(table.path, samples.time, samples.posture, samples.placement, samples.support)
    check_contract(samples, table.path, where, likely)
    return samples


def motion_table(manifest: Manifest, folder: Path) -> MappedTable:
    table = checked_table(folder, MOTION, manifest.tables, MOST_SAMPLES)
    return mapped_samples(manifest, table, folder / "manifest.json")


def mapped_samples(manifest: Manifest, table: TableFile, where: Path) -> MappedTable:
    """Return a table of samples by the names of the contract, whose segments are read as postures."""
    mapping = dict(manifest.mapping or {})
    segment = mapping.pop(SEGMENT, MappingEntry(column=SEGMENT))
    table.require([segment.column])
    mapping["posture"] = segment
    return mapped_table(table, mapping, known_columns(manifest), manifest.gravity, where)


def measurements_in(manifest: Manifest, table: TableFile, where: Path, likely: bool = True) -> Measurements:
    """Check a table against its manifest and return the measurements that it holds.

    Args:
        where: path of the manifest, for messages. likely: see `read_measurements`.
    """
    mapped = mapped_table(table, manifest.mapping or {}, known_columns(manifest), manifest.gravity, where)
    constant = manifest.constant_joints or {}
    mapped.require(required_columns(tuple(manifest.joints), manifest.contacts, constant), MAY_LACK)
    measurements = rows_in(manifest, mapped, where)
    check_contract(measurements, table.path, where, likely)
    return measurements


def read_manifest(folder: Path) -> Manifest:
    """Read and check a measurement folder's manifest.json; warn of a key that looks misspelt."""
    folder = Path(folder)
    check_kind(folder, "measurement")
    where = folder / "manifest.json"
    if not present(where):
        raise IncompleteError(f"{where}: missing{tables_beside(folder)}")
    try:
        manifest = manifest_from(read_json(where))
    except ValidationError as error:
        raise IncompleteError(f"{where}: {validation_message(error)}") from None
    for key in manifest.model_extra or {}:
        if meant := close_to(key, list(type(manifest).model_fields)):
            warn(f"{where}: found the key '{shortened(key)}', which is not read; did you mean '{meant[0]}'?")
    return manifest


def rows_in(manifest: Manifest, table: MappedTable, where: Path) -> Measurements:
    """Return the rows of a table that has the necessary columns; the contract is not checked."""
    angles = _Angles(table, tuple(manifest.joints), manifest.constant_joints or {}, where)
    support = table.texts("support", SUPPORTS) if table.has("support") else np.full(len(table), SUPPORTS[0])
    readings: dict[str, Any]
    if manifest.contacts is None:
        header = header_in(manifest, where)
        readings = {
            "cell_forces": table.matrix("cell", CELLS),
            "cell_forces_sd": table.matrix("cell_std", CELLS, True),
            "plate_poses": read_poses(table),
        }
    else:
        readings = read_contacts(manifest.contacts, table, support, manifest.sensors.cell_sd)
        of_sensors = {key: readings.pop(key) for key in OF_SENSORS if key in readings}
        header = header_in(manifest, where, of_sensors)
    return Measurements.from_arrays(
        header,
        posture=table.integers("posture"),
        placement=table.integers("placement"),
        support=support,
        time=table.numbers("time", True),
        window=table.numbers("window", True),
        samples=table.numbers("samples", True),
        joint_angles=angles.read("q"),
        joint_angles_sd=angles.spreads(),
        command=angles.optional("q_command"),
        motor=angles.optional("motor"),
        joint_rates=angles.optional("q_rate", 0.0),
        joint_accelerations=angles.optional("q_acceleration", 0.0),
        speed=table.numbers("speed", True) if table.has("speed") else None,
        acceleration=table.numbers("acceleration", True) if table.has("acceleration") else None,
        **readings,
    )


def header_in(
    manifest: Manifest, where: Path, of_sensors: Mapping[str, Any] | None = None
) -> MeasurementHeader:
    """Return a manifest's header; cells, heights and contacts of sensors of version 2 are given."""
    mass, sheet, constant = manifest.weighed_mass, manifest.sensors, manifest.constant_joints or {}
    return MeasurementHeader(
        robot={key: getattr(manifest.robot, key) for key in ("model", "sha256", "stance_foot", "swing_foot")},
        joints=tuple(manifest.joints),
        gravity=manifest.gravity,
        sensors=SensorSheet(**{f.name: getattr(sheet, f.name) for f in dataclasses.fields(SensorSheet)}),
        weighed_mass=None if mass is None else (mass.value, mass.sd),
        gains=manifest.gains or {},
        tolerances=manifest.tolerances or {},
        constant_joints={joint: entry.sd for joint, entry in constant.items()},
        conventions=tuple(StatedConvention(**one.model_dump()) for one in manifest.conventions or ()),
        experiments=_experiments(manifest, where),
        **(of_sensors or _plates(manifest)),
    )


def _plates(manifest: Manifest) -> dict[str, Any]:
    assert manifest.plates is not None
    plates = [manifest.plates.right, manifest.plates.left]
    return {
        "cells": np.array([[getattr(plate.cells, corner) for corner in CORNERS] for plate in plates]),
        "top_height": np.array([plate.top_height for plate in plates]),
    }


def _experiments(manifest: Manifest, where: Path) -> tuple[Experiment, ...]:
    """Return session and manipulations if any are stated."""
    texts = tuple(manifest.manipulations or ())
    arrangement_of(texts, f"{where}: key 'manipulations'")
    found = Experiment(manifest.session or "", texts)
    return () if found == Experiment() else (found,)


@dataclass(frozen=True)
class _Angles:
    """Columns of the joints, some of which are not logged but constant."""

    table: MappedTable
    joints: tuple[str, ...]
    constant: Mapping[str, ConstantEntry]
    where: Path

    def __post_init__(self) -> None:
        for joint in self.constant:
            look_up("joint", joint, self.joints, f"{self.where}: key 'constant_joints'")
            if self.table.has(f"q.{joint}"):
                raise InputError(
                    f"{self.table.path}: found column 'q.{joint}' of a joint that the manifest lists in "
                    "'constant_joints', expected one of them"
                )

    def read(self, prefix: str, constant: float | None = None) -> np.ndarray:
        """Return the angles, (m, n_joints) [rad]; constant joints have theirs, or else what is given."""
        columns = [
            np.full(len(self.table), self.constant[joint].value if constant is None else constant)
            if joint in self.constant
            else self.table.numbers(f"{prefix}.{joint}")
            for joint in self.joints
        ]
        return np.column_stack(columns)

    def spreads(self) -> np.ndarray:
        """Return the s.d. over the windows, (m, n_joints) [rad]; NaN where unknown."""
        return self.table.matrix("q_std", self.joints, True)

    def optional(self, prefix: str, constant: float | None = None) -> np.ndarray | None:
        """Return the angles, rates or accelerations, or None without any of their columns."""
        given = any(self.table.has(f"{prefix}.{joint}") for joint in self.joints)
        return self.read(prefix, constant) if given else None
