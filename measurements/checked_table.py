"""Tables verified by the hashes in their folder's manifest."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import IncompleteError, InputError, listed, shortened
from tulip_testbed.base.files import present, read_bytes
from tulip_testbed.base.table_files import MOST_ROWS, TableFile, is_number

EDITED = "; if it was edited on purpose, remove 'tables' from manifest.json and the other table"
TWINS = 1e-6  # relative, and of a unit: difference of two tables that are one, written with fewer digits


def checked_table(
    folder: Path,
    name: str,
    tables: Mapping[str, str | None] | None,
    most_rows: int = MOST_ROWS,
    advice: str = EDITED,
) -> TableFile:
    """Read NAME.parquet, or else NAME.csv, and verify it by the hashes in the manifest.

    With both tables present it is unclear which one is meant, unless the manifest lists both hashes.

    Args:
        advice: what to do about a table that was edited, for the message.
    """
    paths = [folder / f"{name}.{suffix}" for suffix in ("parquet", "csv")]
    found = [path for path in paths if present(path)]
    if not found:
        raise IncompleteError(
            f"{folder}: found neither {name}.parquet nor {name}.csv, expected one of them"
            f"{tables_beside(folder)}"
        )
    contents = [read_bytes(path) for path in found]
    hashes = tables or {}
    for path, content in zip(found, contents, strict=True):
        expected = hashes.get(path.name)
        if expected is not None:
            _check_hash(path, content, expected, advice)
        elif len(found) > 1:
            twin = next(other.name for other in found if other != path)
            raise InputError(
                f"{path}: found together with {twin} and without a sha256 in the manifest's 'tables', "
                "expected one of the two tables or both hashes"
            )
    table = TableFile(found[0], contents[0], most_rows)
    if len(found) > 1:
        _check_twin(table, found[1], contents[1])
    return table


def _check_twin(table: TableFile, path: Path, content: bytes) -> None:
    """Refuse a CSV file next to a Parquet file if it is unclear which of them is right."""
    if content == table.as_csv():  # parsing takes a second for 10,000 rows
        return
    twin = TableFile(path, content, table.most_rows)
    of_both = f"{path}: next to {table.path.name}"
    if len(twin) != len(table):
        raise InputError(f"{of_both}: found {len(twin)} rows, expected its {len(table)}")
    for name, kind in table.types.items():
        if not is_number(kind):
            continue
        if not twin.has(name):
            raise InputError(f"{of_both}: column '{shortened(name)}' is missing")
        values = [one.numbers(name, missing_allowed=True) for one in (table, twin)]
        if not (same := np.isclose(*values, rtol=TWINS, atol=TWINS, equal_nan=True)).all():
            row = int(same.argmin())
            raise InputError(
                f"{of_both}: column '{shortened(name)}', row {row + 1}: found {values[1][row]:g}, "
                f"expected its {values[0][row]:g}; keep the table that is right"
            )


def tables_beside(folder: Path) -> str:
    """Name the tables in a folder for a message that something else is missing."""
    try:
        names = sorted(path.name for path in folder.iterdir() if path.suffix in (".csv", ".parquet"))
    except OSError:  # a folder that may be searched but not listed
        names = []
    return f"; found {shortened(listed(names), 200)}" if names else ""


def _check_hash(path: Path, content: bytes, expected: str, advice: str) -> None:
    if (found := hashlib.sha256(content).hexdigest()) != expected.lower():
        raise InputError(
            f"{path}: hash mismatch: found sha256 {found[:12]}..., "
            f"expected {shortened(expected[:12])}... by the manifest{advice}"
        )
