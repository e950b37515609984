"""Collect all faults that keep a measurement folder from being read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.files import present
from tulip_testbed.base.table_files import read_json
from tulip_testbed.base.validation_message import missing_keys, wrong_values
from tulip_testbed.measurements.checked_table import checked_table
from tulip_testbed.measurements.column_mapping import MappedTable, mapped_table
from tulip_testbed.measurements.contract import SUPPORTS, WHOLE
from tulip_testbed.measurements.manifest import Manifest, manifest_from
from tulip_testbed.measurements.measurement_folder import (
    MAY_LACK,
    known_columns,
    motion_table,
    moves,
    read_samples,
    required_columns,
)


def complaints(folder: Path, joints: tuple[str, ...]) -> dict[str, list[str]]:
    """List everything missing or wrong in a folder's "manifest" and "table"; empty if it can be read.

    Args:
        joints: joint names of the robot, whose columns are required.
    """
    manifest: dict[str, Any] = {}
    where = folder / "manifest.json"
    about = [f"{where}: missing"]
    if present(where):
        about = _collect(lambda: manifest.update(read_json(where)))
        about += [] if about else _manifest_complaints(where, manifest)
    listed_hashes = manifest.get("tables")
    hashes = listed_hashes if isinstance(listed_hashes, dict) else {}
    hashes = {name: value for name, value in hashes.items() if isinstance(value, str)}
    known = None if about else manifest_from(manifest)
    tables: list[MappedTable] = []

    def read() -> None:
        if moves(folder):
            if known is not None:
                tables.append(motion_table(known, folder))
            return
        table = checked_table(folder, "postures", hashes)
        if known is None:
            tables.append(MappedTable(table, {}, 1.0))
        else:
            mapping = known.mapping or {}
            tables.append(mapped_table(table, mapping, known_columns(known), known.gravity, where))

    within = _collect(read)
    within += [text for table in tables for text in _table_complaints(table, joints, known)]
    if not (about or within):
        within = _collect(lambda: read_samples(folder, likely=False))
    return {"manifest": about, "table": within}


def _manifest_complaints(where: Path, manifest: dict[str, Any]) -> list[str]:
    try:
        manifest_from(manifest)
    except ValidationError as error:
        missing = missing_keys(error)
        texts = [f"{where}: keys missing: {listed(missing)} (null if unknown)"] if missing else []
        return texts + [f"{where}: {message}" for message in wrong_values(error)]
    return []


def _table_complaints(table: MappedTable, joints: tuple[str, ...], manifest: Manifest | None) -> list[str]:
    """List what is missing or wrong in a table; without a manifest, contacts are those of version 1."""
    if manifest is None:
        required = required_columns(joints)
    else:
        required = required_columns(joints, manifest.contacts, manifest.constant_joints or {})
    missing = [name for name in required if not table.has(name)]
    texts = [f"{table.path}: columns missing: {listed(missing)}"] if missing else []
    names = list(table.types)
    known = {*required, *MAY_LACK}
    strange = [name for name in names if name not in known and name.partition(".")[0] not in MAY_LACK]
    if missing and strange:
        texts.append(f"{table.path}: columns that the format does not know: {listed(strange)}")
    for name in [name for name in required if table.has(name)]:
        texts += _collect(
            lambda name=name: (
                table.integers(name)
                if name in WHOLE
                else table.numbers(name, name.startswith(("wrench.", "cop.")))
            )
        )
    for name in [name for name in names if name.partition(".")[0] in MAY_LACK]:
        if name == "support":
            texts += _collect(lambda: table.texts("support", SUPPORTS))
        else:
            gaps = not name.startswith(("q_command.", "motor."))
            texts += _collect(lambda name=name, gaps=gaps: table.numbers(name, missing_allowed=gaps))
    return texts


def _collect(action: Callable[[], Any]) -> list[str]:
    try:
        action()
    except InputError as error:
        return [str(error)]
    return []
