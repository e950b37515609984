"""Import a laboratory's own table: propose a mapping, write a measurement folder, check it with the robot."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError, listed, look_up
from tulip_testbed.base.files import new_folder, read_bytes, sha256, write_bytes
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import Table as Read
from tulip_testbed.base.table_files import software, write_json
from tulip_testbed.experiments.table_import.column_names import Proposal, propose, with_units
from tulip_testbed.experiments.table_import.import_map import ONE, ImportMap, with_unknowns
from tulip_testbed.experiments.table_import.sign_checks import SignCheck, check_signs
from tulip_testbed.identification.contact_readings import ASSUMED_FORCE, ASSUMED_MOMENT
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements import read_measurements
from tulip_testbed.measurements.column_mapping import check_mapping
from tulip_testbed.measurements.contact_entries import CopEntry, WrenchEntry
from tulip_testbed.measurements.contract import WHOLE
from tulip_testbed.measurements.manifest import manifest_from
from tulip_testbed.measurements.measurement_folder import known_columns, required_columns
from tulip_testbed.sim.robot import Robot, joint_names

GRAVITY = 9.81  # m/s2
AS_WRITTEN = ("time", "window", "samples", "speed", "acceleration")  # exact names that others use too
LIFTED = 0.05  # of the weight, below which a foot may be in the air


@dataclass(frozen=True)
class MappedColumn:
    """Source of a column of the contract.

    Attributes:
        column: of the table. unit: None: the contract's. sign: 1 or -1.
        by: how it was found. checked: what confirmed its sign; None: nothing.
    """

    column: str
    unit: str | None
    sign: int
    by: str
    checked: str | None


@dataclass(frozen=True, repr=False)
class ImportedTable(Result):
    """The result of importing a table.

    Attributes:
        mapped: by column of the contract.
        assumed: what neither the table nor the user says. problems: what the user has to decide or look at.
        unused: columns of the table that are not read.
        folder: the measurement folder; None if something necessary is missing.
    """

    mapped: dict[str, MappedColumn]
    assumed: tuple[str, ...]
    problems: tuple[str, ...]
    unused: tuple[str, ...]
    folder: str | None

    @property
    def exit_code(self) -> int:
        """Return 0 if the folder was written, though perhaps with problems to look at, or else 1."""
        return int(self.folder is None)

    def tables(self) -> list[Table | str]:
        """Return the mapping, and what was assumed and is to be decided."""
        columns = (Column("of the contract"), Column("of the table"), Column("unit"), Column("sign"))
        columns = (*columns, Column("found by"), Column("sign checked by"))
        rows = [
            [name, one.column, one.unit or "", f"{one.sign:+d}", one.by, one.checked or ""]
            for name, one in self.mapped.items()
        ]
        parts: list[Table | str] = [Table("Columns", columns, rows)]
        if self.unused:
            parts.append(f"Not read: {listed(self.unused)}")
        for title, lines in (("Assumed", self.assumed), ("Problems", self.problems)):
            if lines:
                parts += [f"{title}:", *(f"- {line}" for line in lines)]
        if self.folder is None:
            return [*parts, "No folder was written; state what is missing with `map`."]
        return [*parts, f"Measurement folder: {self.folder}"]


@dataclass
class _Work:
    """The state of an import."""

    table: Read
    robot: Robot
    stated: ImportMap
    assumed: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    added: dict[str, np.ndarray] = field(default_factory=dict)


def import_table(table: Path, robot: Robot, folder: Path, stated: ImportMap) -> ImportedTable:
    """Write a measurement folder with a laboratory's own table, which is read through a mapping.

    Args:
        table: CSV or Parquet, one row a held posture.
        folder: a new one; it is written only if nothing necessary is missing.
        stated: what the table does not say itself.

    Raises:
        InputError: a table that cannot be read, a statement that does not fit it, or a folder that exists.
    """
    stated = stated.model_copy(update={"columns": with_units(stated.columns)})
    work = _Work(Read(table, read_bytes(table)), robot, stated)
    manifest = _manifest(work)
    if stated.contacts is None and stated.plates is None:
        names = tuple(name for name in known_columns(manifest) if not name.startswith(("cell", "plate.")))
        required = tuple(name for name in names if name in (*WHOLE, *_angles(work)))
        work.missing.append(
            "contacts: not stated; state kind, mount, channels, zero and pose of both as [[contacts]], or "
            "the cells and heights of [plates] (docs/reference/measurements.md)"
        )
    else:
        names = known_columns(manifest)
        constant = stated.constant_joints
        required = required_columns(tuple(manifest.joints), manifest.contacts, constant)
    check_mapping(stated.columns, known_columns(manifest), "map", "columns")
    _check_columns(work)
    found = propose(list(work.table.types), names, required, stated.columns)
    work.problems += found.undecided
    if found.silent:
        work.assumed.append(
            f"not used, since no unit is written in the name: {listed(map(repr, found.silent))}; state it to "
            "use one"
        )
    _complete(work, found)
    has = {*found.mapping, *found.exact, *work.added}
    if lacks := [name for name in required if name not in has]:
        undecided = {text.partition(":")[0] for text in found.undecided}
        if angles := [name for name in lacks if name.startswith("q.") and name not in undecided]:
            work.missing.append(
                f"no column for {listed(angles)}; state one, or a constant in [constant_joints]"
            )
        if others := [name for name in lacks if not name.startswith("q.") and name not in undecided]:
            work.missing.append(f"no column for {listed(others)}; state one")
        work.missing += [text for text in found.undecided if text.partition(":")[0] in lacks]
        work.problems = [text for text in work.problems if text not in work.missing]
    signs = SignCheck({}, [])
    if not work.missing:
        signs = _write(work, found, manifest.model_dump(exclude_unset=True), Path(folder))
    mapped = _mapped(found, stated, signs, work)
    _tell_signs(work, mapped)
    return ImportedTable(
        mapped=mapped,
        assumed=tuple(work.assumed),
        problems=(*work.missing, *work.problems, *signs.doubtful),
        unused=tuple(found.unused),
        folder=None if work.missing else str(folder),
    )


def _angles(work: _Work) -> list[str]:
    constant = work.stated.constant_joints
    return [f"q.{joint}" for joint in joint_names(work.robot.model) if joint not in constant]


def _manifest(work: _Work) -> Any:
    """Return the manifest without its mapping; without contacts it is that of any plates."""
    stated, robot = work.stated, work.robot
    joints = joint_names(robot.model)
    for joint in stated.constant_joints:
        look_up("joint", joint, joints, "map: key 'constant_joints'")
    if stated.contacts is not None and stated.plates is not None:
        raise InputError("map: found 'contacts' and 'plates', expected one of them")
    if stated.gravity is None:
        work.assumed.append(f"gravity {GRAVITY:g} m/s2")
    if work.stated.weighed_mass is None:
        work.assumed.append("the weighed mass is unknown")
    work.assumed += _unstated(stated.contacts or [])
    plain = json.loads(stated.model_dump_json(exclude_none=True))
    corners = {"front_left": [1, 1], "front_right": [1, -1], "rear_right": [-1, -1], "rear_left": [-1, 1]}
    nothing = {side: {"cells": corners, "top_height": 0.0} for side in ("right", "left")}
    contacts = [with_unknowns(entry) for entry in plain.get("contacts", [])]
    return manifest_from(
        {
            "format": "tulip-measurements",
            "version": 2 if contacts else 1,
            "robot": {
                "model": robot.model_file.name,
                "sha256": robot.model_hash,
                "stance_foot": robot.stance_foot,
                "swing_foot": robot.swing_foot,
            },
            "joints": list(joints),
            **({"contacts": contacts} if contacts else {"plates": plain.get("plates", nothing)}),
            "weighed_mass": plain.get("weighed_mass"),
            "gravity": plain.get("gravity", GRAVITY),
            "sensors": stated.sensors.model_dump(),
            **{key: plain[key] for key in ("gains", "tolerances", "constant_joints") if plain.get(key)},
        }
    )


def _unstated(contacts: Sequence[Any]) -> list[str]:
    """Say what is assumed of contact sensors of which a data sheet would say more."""
    lines = []
    if any(isinstance(one, WrenchEntry) and one.covariance is None for one in contacts):
        lines.append(
            "the contact sensors' `covariance` is unknown: every averaged reading is taken to err by "
            f"{ASSUMED_FORCE:g} N or {ASSUMED_MOMENT:g} Nm (1 s.d.)"
        )
    if any(isinstance(one, CopEntry) and one.sd is None for one in contacts):
        lines.append(
            "the `sd` of the centres of pressure is unknown: their forces are taken to err by "
            f"{ASSUMED_FORCE:g} N and the moments by {ASSUMED_MOMENT:g} Nm (1 s.d.)"
        )
    if any(isinstance(one, WrenchEntry) and one.mount == "foot" and one.below is None for one in contacts):
        lines.append(
            "no `below` is stated: the foot is assumed to have no mass below its sensor, as in a sole; "
            "an ankle's sensor "
            "does not weigh the foot, whose mass and centre it needs"
        )
    return lines


def _check_columns(work: _Work) -> None:
    for name, entry in work.stated.columns.items():
        look_up("column", entry.column, work.table.types, f"{work.table.path}: map of {name}")


def _complete(work: _Work, found: Proposal) -> None:
    """Add the numbers of postures and placements, and say what the support and plain names stand for."""
    has, count = {*found.mapping, *found.exact}, len(work.table)
    for name in AS_WRITTEN:
        if name in found.exact:
            work.assumed.append(f"column '{name}' is the contract's `{name}`, in its unit")
    if "posture" not in has:
        work.added["posture"] = np.arange(1, count + 1)
        work.assumed.append("postures are numbered by row: none was measured twice")
    if "placement" not in has:
        _add_placement(work, found)
    if "support" not in has:
        work.assumed.append("both feet carry the robot in all rows (support 'double')")


def _add_placement(work: _Work, found: Proposal) -> None:
    count = len(work.table)
    poses = [name for name in (*found.mapping, *found.exact) if name.startswith("plate.")]
    how = work.stated.placement
    if how is None and poses:
        columns = [found.mapping[name].column if name in found.mapping else name for name in poses]
        values = np.column_stack([work.table.numbers(column) for column in columns])
        moved = np.append(False, (values[1:] != values[:-1]).any(axis=1))
        work.added["placement"] = 1 + np.cumsum(moved)
        work.assumed.append("a new placement begins where a plate's recorded pose changes")
        return
    if how is None:
        work.assumed.append(
            f"every row is a placement of its own, as if the feet were moved between any two; state "
            f"placement = '{ONE}' if they stayed"
        )
    work.added["placement"] = np.ones(count, int) if how == ONE else np.arange(1, count + 1)


def _write(work: _Work, found: Proposal, manifest: dict[str, Any], folder: Path) -> SignCheck:
    """Write the folder, read it as everybody will, and hold it against the robot.

    An entry that cannot be read is a problem, and nothing is left.
    """
    with_mapping = {name: entry.model_dump(exclude_none=True) for name, entry in found.mapping.items()}
    try:
        with new_folder(folder) as working:
            paths = _tables(work, working)
            manifest |= {"mapping": with_mapping} if with_mapping else {}
            manifest |= {"software": software(), "tables": {path.name: sha256(path) for path in paths}}
            write_json(working / "manifest.json", manifest)
            try:
                measurements = read_measurements(working)
            except InputError as error:
                raise _RefusedError(_of_the_table(str(error), working, work.table.path, found)) from None
    except _RefusedError as refused:
        work.missing.append(str(refused))
        return SignCheck({}, [])
    _tell_lifted(work, measurements)
    return check_signs(measurements, nominal_robot(work.robot))


def _of_the_table(message: str, working: Path, table: Path, found: Proposal) -> str:
    """Return a message on a folder that is not written as one on the table and the map."""
    for path in working.iterdir():
        name = "map" if path.name == "manifest.json" else str(table)
        message = message.replace(str(path), name)
    message = message.partition("; `check` lists")[0].replace(str(working), "map")
    named = [name for name in found.mapping if f"'{name}'" in message]
    return message + "".join(f"; {name} is column '{found.mapping[name].column}'" for name in named)


class _RefusedError(InputError):
    """The folder would break the contract."""


def _tables(work: _Work, folder: Path) -> list[Path]:
    """Write the table as it is; with columns that were added as CSV."""
    source = work.table.path
    if not work.added:
        path = folder / f"postures{source.suffix if source.suffix == '.parquet' else '.csv'}"
        write_bytes(path, read_bytes(source))
        return [path]
    content = work.table.table
    for name, values in work.added.items():
        content = content.append_column(name, pa.array(values))
    path = folder / "postures.csv"
    pyarrow.csv.write_csv(content, path)
    return [path]


def _tell_lifted(work: _Work, measurements: Any) -> None:
    m = measurements
    if m.contacts is None:
        loads = m.cell_forces.reshape(-1, 2, 4).sum(axis=2)
    else:
        loads = m.wrenches[..., m.contacts.channels.index("fz")]
    share = loads / np.nansum(loads, axis=1, keepdims=True)
    light = (np.nan_to_num(share) < LIFTED).any(axis=1) & (m.support == "double")
    if light.any():
        work.problems.append(
            f"support: in row {int(light.argmax()) + 1} one foot carries less than {100 * LIFTED:.0f} % of "
            "the weight, though both are said to stand; state a column 'support'"
        )


def _mapped(found: Proposal, stated: ImportMap, signs: SignCheck, work: _Work) -> dict[str, MappedColumn]:
    rows = {}
    for name in (*found.exact, *found.mapping):
        entry = found.mapping.get(name)
        rows[name] = MappedColumn(
            column=name if entry is None else entry.column,
            unit=None if entry is None else entry.unit,
            sign=1 if entry is None else entry.sign,
            by="name" if entry is None else "statement" if name in stated.columns else "words of the name",
            checked=signs.confirmed.get(name) or signs.confirmed.get(name.rpartition(".")[0]),
        )
    return rows | {name: MappedColumn(name, None, 1, "added", None) for name in work.added}


SIGNED = ("q.", "wrench.", "cop.", "plate.", "motor.", "q_command.")


def _tell_signs(work: _Work, mapped: Mapping[str, MappedColumn]) -> None:
    """Say which signs are assumed and which of them nothing has checked."""
    signed = [name for name in mapped if name.startswith(SIGNED) and mapped[name].by != "statement"]
    unchecked = [name for name in signed if not mapped[name].checked]
    if unchecked:
        work.assumed.append(f"signs +1, which nothing here has checked: {listed(unchecked)}")
