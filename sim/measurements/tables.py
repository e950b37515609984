"""Tables on disk and folders that appear whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from sim.errors import InputError
from sim.measurements.spreadsheet import plain_csv

Columns = dict[str, np.ndarray]


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder to fill; it gets its name when the block ends well, else nothing stays behind.

    Raises:
        InputError: the folder exists already or cannot be made.
    """
    path = Path(path)
    if path.exists():
        raise InputError(f"{path}: exists already; give the name of a new folder")
    working = path.parent / f".{path.name}.{uuid.uuid4().hex[:8]}"
    try:
        working.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{path}: cannot make the folder ({error.strerror})") from None
    try:
        yield working
        os.rename(working, path)
    except OSError as error:
        raise InputError(f"{path}: cannot write the folder ({error.strerror})") from None
    finally:
        shutil.rmtree(working, ignore_errors=True)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write one JSON document; the file appears whole."""
    working = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        working.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        os.replace(working, path)
    except OSError as error:
        raise InputError(f"{path}: cannot write ({error.strerror})") from None
    finally:
        working.unlink(missing_ok=True)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        InputError: no such file, no JSON, or no object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read ({error.strerror})") from None
    except ValueError as error:
        raise InputError(f"{path}: not a JSON file ({error})") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: found a {type(content).__name__}, expected an object")
    return content


def write_table(folder: Path, name: str, columns: Columns) -> dict[str, Path]:
    """Write NAME.parquet and NAME.csv with the same columns."""
    table = pa.table({key: pa.array(value) for key, value in columns.items()})
    paths = {suffix: folder / f"{name}.{suffix}" for suffix in ("parquet", "csv")}
    pyarrow.parquet.write_table(table, paths["parquet"])
    pyarrow.csv.write_csv(table, paths["csv"])
    return paths


def find_table(folder: Path, name: str) -> Path:
    """NAME.parquet, or NAME.csv where there is none.

    Raises:
        InputError: neither exists.
    """
    for suffix in ("parquet", "csv"):
        if (path := folder / f"{name}.{suffix}").is_file():
            return path
    raise InputError(f"{folder}: found neither {name}.parquet nor {name}.csv, expected one of them")


class Table:
    """A table read from disk whose columns are checked as they are taken."""

    def __init__(self, path: Path):
        self.path = path
        try:
            self.table: pa.Table = (
                pyarrow.parquet.read_table(path)
                if path.suffix == ".parquet"
                else pyarrow.csv.read_csv(pa.BufferReader(plain_csv(path, path.read_bytes())))
            )
        except (pa.ArrowException, OSError, ValueError) as error:
            raise InputError(f"{path}: broken table: {' '.join(str(error).split())}") from None
        names = self.table.column_names
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise InputError(f"{path}: column '{repeated[0]}' stands more than once")
        if len(self) == 0:
            raise InputError(f"{path}: found no rows, expected one per posture")

    def __len__(self) -> int:
        return self.table.num_rows

    def has(self, name: str) -> bool:
        return name in self.table.column_names

    def _column(self, name: str) -> pa.ChunkedArray:
        if not self.has(name):
            raise InputError(f"{self.path}: column '{name}' is missing")
        return self.table.column(name)

    def numbers(self, name: str, missing_allowed: bool = False) -> np.ndarray:
        """A column of finite numbers, (m,); NaN where a missing value or column is allowed."""
        if missing_allowed and not self.has(name):
            return np.full(len(self), np.nan)
        column = self._column(name)
        if pa.types.is_null(column.type) and missing_allowed:
            return np.full(len(self), np.nan)
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
            raise InputError(
                f"{self.path}: column '{name}': found {column.type}, expected numbers{_first_text(column)}"
            )
        values = column.to_numpy().astype(float)
        wrong = ~np.isfinite(values)
        if missing_allowed:
            wrong = np.isinf(values)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise InputError(
                f"{self.path}: column '{name}', row {row + 1}: found {values[row]}, expected a finite number"
            )
        return values

    def integers(self, name: str) -> np.ndarray:
        """A column of whole numbers, (m,)."""
        values = self.numbers(name)
        if (wrong := np.flatnonzero((values != np.round(values)) | (np.abs(values) > 2**53))).size:
            raise InputError(
                f"{self.path}: column '{name}', row {wrong[0] + 1}: found {values[wrong[0]]}, "
                "expected a whole number"
            )
        return values.astype(np.int64)

    def texts(self, name: str, valid: tuple[str, ...]) -> np.ndarray:
        """A column of texts out of `valid`, (m,)."""
        values = self._column(name).to_pylist()
        for row, value in enumerate(values, 1):
            if value not in valid:
                raise InputError(
                    f"{self.path}: column '{name}', row {row}: found {value!r}, "
                    f"expected one of {', '.join(valid)}"
                )
        return np.array(values)

    def matrix(self, prefix: str, names: tuple[str, ...], missing_allowed: bool = False) -> np.ndarray:
        """Columns PREFIX.NAME side by side, (m, len(names))."""
        return np.column_stack([self.numbers(f"{prefix}.{name}", missing_allowed) for name in names])


def _first_text(column: pa.ChunkedArray) -> str:
    """Which row holds what is no number, for a message."""
    if pa.types.is_string(column.type):
        for row, value in enumerate(column.to_pylist(), 1):
            try:
                float(value or "nan")
            except ValueError:
                return f" (row {row}: {value[:40]!r})"
    return ""


def software() -> dict[str, str]:
    """Versions of what computed a result."""
    versions = {}
    for package in ("tulip-testbed", "mujoco", "mink", "numpy", "scipy", "pyarrow"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return versions
