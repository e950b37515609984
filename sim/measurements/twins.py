"""Which of a folder's tables is read: the Parquet or its CSV twin, both as the manifest lists them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from tulip_testbed.sim.errors import InputError, shortened
from tulip_testbed.sim.files import present, read_bytes
from tulip_testbed.sim.measurements.table_files import MOST_ROWS, Table


def checked_table(
    folder: Path, name: str, tables: Mapping[str, str | None] | None, most_rows: int = MOST_ROWS
) -> Table:
    """NAME.parquet, or NAME.csv where there is none; intact where the manifest gives its hash.

    Nobody can say which of two tables is meant, unless both are what the manifest lists.

    Raises:
        InputError: no table, one that is not what the manifest lists, or two without their hashes.
    """
    paths = [folder / f"{name}.{suffix}" for suffix in ("parquet", "csv")]
    found = [path for path in paths if present(path)]
    if not found:
        raise InputError(f"{folder}: found neither {name}.parquet nor {name}.csv, expected one of them")
    contents = [read_bytes(path) for path in found]
    hashes = tables or {}
    for path, content in zip(found, contents, strict=True):
        expected = hashes.get(path.name)
        if expected is not None:
            _check_hash(path, content, expected)
        elif len(found) > 1:
            twin = next(other.name for other in found if other != path)
            raise InputError(
                f"{path}: found beside {twin} and without a sha256 in the manifest's 'tables', "
                "expected one of the two tables or both hashes"
            )
    return Table(found[0], contents[0], most_rows)


def _check_hash(path: Path, content: bytes, expected: str) -> None:
    if (found := hashlib.sha256(content).hexdigest()) != expected.lower():
        raise InputError(
            f"{path}: hash mismatch: found sha256 {found[:12]}..., "
            f"expected {shortened(expected[:12])}... by the manifest"
        )
