"""Which of a folder's tables is read: the Parquet or its CSV twin, both as the manifest lists them."""

from __future__ import annotations

import hashlib
from pathlib import Path

from sim.errors import InputError, shortened
from sim.files import present, read_bytes
from sim.measurements.tables import Table


def checked_table(folder: Path, name: str, tables: dict[str, str]) -> Table:
    """NAME.parquet, or NAME.csv where there is none; the other one must be intact too.

    Raises:
        InputError: no table, or one that is not what the manifest lists.
    """
    paths = [folder / f"{name}.{suffix}" for suffix in ("parquet", "csv")]
    found = [path for path in paths if present(path)]
    if not found:
        raise InputError(f"{folder}: found neither {name}.parquet nor {name}.csv, expected one of them")
    contents = [read_bytes(path) for path in found]
    for path, content in zip(found, contents, strict=True):
        _check_hash(path, content, tables)
    return Table(found[0], contents[0])


def _check_hash(path: Path, content: bytes, tables: dict[str, str]) -> None:
    if path.name not in tables:
        raise InputError(f"{path}: the manifest's 'tables' does not list it")
    if (found := hashlib.sha256(content).hexdigest()) != (expected := tables[path.name].lower()):
        raise InputError(
            f"{path}: hash mismatch: found sha256 {found[:12]}..., "
            f"expected {shortened(expected[:12])}... by the manifest"
        )
