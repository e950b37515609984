"""Tables and JSON documents on disk: write them atomically, and read them without trusting them."""

import copy
import json
import math
from collections.abc import Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from tulip_testbed.base.errors import IncompleteError, InputError, close_to, listed, shortened
from tulip_testbed.base.files import read_text, write_text
from tulip_testbed.base.spreadsheet import plain_csv

Columns = dict[str, np.ndarray]

MOST_JSON = 4 * 2**20  # bytes
MOST_DEPTH = 32  # of a JSON document
MOST_DIGITS = 300  # of a whole number in JSON: a float still holds it
LARGEST = 1e60  # number in a JSON file: products of several are finite
MOST_ROWS = 10_000
MOST_COLUMNS = 1_000
MOST_UNPACKED = 256 * 2**20  # bytes of a Parquet file after unpacking, by its own metadata


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON document atomically."""
    write_text(path, json_text(content))


def json_text(content: dict[str, Any]) -> str:
    """Return a JSON document as the text of its file."""
    return json.dumps(content, indent=1) + "\n"


def finite(value: Any) -> Any:
    """Return a document with None for every infinite number and NaN, neither of which JSON knows."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object of at most `MOST_JSON` bytes whose keys are unique and whose numbers are finite."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(pairs)
        if len(content) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{path}: found key '{shortened(twice)}' more than once in its object")
        return content

    def number(text: str) -> float:
        if not math.isfinite(value := float(text)):
            raise InputError(f"{path}: found the number {shortened(text)}, expected a finite one")
        return value

    def whole(text: str) -> int:
        if len(text) > MOST_DIGITS:
            raise InputError(f"{path}: found a number of {len(text)} digits, expected at most {MOST_DIGITS}")
        return int(text)

    text = read_text(path, MOST_JSON)
    try:
        content = json.loads(
            text, object_pairs_hook=unique, parse_float=number, parse_int=whole, parse_constant=number
        )
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: not a JSON file ({error})") from None
    except RecursionError:
        raise InputError(f"{path}: nested deeper than {MOST_DEPTH} levels") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: found a {type(content).__name__}, expected an object")
    _check_values(path, content, ())
    return content


def _check_values(path: Path, value: Any, keys: tuple[Any, ...]) -> None:
    """Refuse values that could be read but neither computed with, nor printed, nor written again."""
    if len(keys) == MOST_DEPTH:
        raise InputError(f"{path}: nested deeper than {MOST_DEPTH} levels")
    if isinstance(value, dict):
        _check_values(path, list(value), keys)
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _check_values(path, item, (*keys, key))
    elif isinstance(value, str) and any("\ud800" <= sign <= "\udfff" for sign in value):
        raise InputError(f"{path}: found half a surrogate pair in {shortened(value)}, expected text")
    elif isinstance(value, float) and abs(value) > LARGEST:
        where = f"{path}: key '{shortened('.'.join(map(str, keys)))}'"
        raise InputError(f"{where}: found {value:g}, expected a finite number within {LARGEST:g}")


def write_table(folder: Path, name: str, columns: Columns) -> dict[str, Path]:
    """Write NAME.parquet and NAME.csv with the same columns."""
    table, paths = _table_of(columns), {suffix: folder / f"{name}.{suffix}" for suffix in ("parquet", "csv")}
    pyarrow.parquet.write_table(table, paths["parquet"])
    pyarrow.csv.write_csv(table, paths["csv"])
    return paths


def write_parquet(folder: Path, name: str, columns: Columns) -> Path:
    """Write NAME.parquet alone, small, as for a long table that nobody reads by eye."""
    path = folder / f"{name}.parquet"
    smooth = [name for name, values in columns.items() if values.dtype.kind == "f"]
    others = [name for name in columns if name not in smooth]
    options = {"compression": "zstd", "use_byte_stream_split": smooth, "use_dictionary": others}
    pyarrow.parquet.write_table(_table_of(columns), path, **options)
    return path


def _table_of(columns: Columns) -> pa.Table:
    return pa.Table.from_arrays([_arrow(value) for value in columns.values()], list(columns))


def _arrow(values: np.ndarray) -> pa.Array:
    """Return a column for Arrow; `pa.array` would load pandas, which takes a quarter of a second."""
    if values.dtype.kind == "U":
        texts = [text.encode() for text in values.tolist()]
        ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
        return pa.StringArray.from_buffers(len(texts), pa.py_buffer(ends), pa.py_buffer(b"".join(texts)))
    if values.dtype.kind in "if":
        kind, buffer = pa.from_numpy_dtype(values.dtype), pa.py_buffer(np.ascontiguousarray(values))
        return pa.Array.from_buffers(kind, len(values), [None, buffer])
    return pa.array(values)


def refuse_rows(where: Path | str, name: str, rows: np.ndarray, values: np.ndarray, expected: str) -> None:
    """Refuse the first row of a column where `rows`, (m,), is true."""
    if rows.any():
        row = int(rows.argmax())
        raise InputError(f"{where}: column '{name}', row {row + 1}: found {values[row]}, expected {expected}")


class TableFile:
    """A table whose columns are checked when they are read.

    Attributes:
        path: the file.
        types: type of each column; columns that are neither numbers nor short texts are not read.
    """

    def __init__(self, path: Path, content: bytes, most_rows: int = MOST_ROWS):
        self.path, self.most_rows = path, most_rows
        try:
            if path.suffix == ".parquet":
                self.types, self.table = self._parquet(content)
            else:
                self.types, self.table = self._csv(content)
        except InputError:
            raise
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise InputError(f"{path}: broken table: {shortened(error, 200)}") from None
        if len(self) == 0:
            raise InputError(f"{path}: found no rows, expected one per posture")

    @classmethod
    def of_columns(cls, path: Path, columns: Columns) -> Self:
        """Return columns of numbers, (n,) each, that were read from a file of another kind."""
        made = cls.__new__(cls)
        made.path, made.most_rows = path, len(next(iter(columns.values()), ()))
        made._limit("columns", len(columns), MOST_COLUMNS)
        made.table = pa.Table.from_arrays([_arrow(value) for value in columns.values()], list(columns))
        made.types = made._unique(made.table.column_names, made.table.schema.types)
        return made

    def with_columns(self, columns: Columns) -> Self:
        """Return the table with more columns, (n,) each, which replace those of the same names."""
        more = copy.copy(self)
        more.table = more.table.drop_columns([name for name in columns if name in more.table.column_names])
        for name, values in columns.items():
            more.table = more.table.append_column(name, _arrow(values))
        more.types = self.types | {name: more.table.schema.field(name).type for name in columns}
        return more

    def take(self, rows: np.ndarray) -> Self:
        """Return some rows, (m,) bool."""
        some = copy.copy(self)
        some.table = self.table.filter(_arrow(rows))
        return some

    def _parquet(self, content: bytes) -> tuple[dict[str, pa.DataType], pa.Table]:
        """Unpack only files of declared small size; keep texts as a dictionary, since they may repeat."""
        file = pyarrow.parquet.ParquetFile(pa.BufferReader(content))
        said, schema = file.metadata, file.schema_arrow
        groups = [said.row_group(k) for k in range(min(said.num_row_groups, self.most_rows))]
        unpacked = sum(max(group.total_byte_size, 0) for group in groups)
        self._limit("rows", max(said.num_rows, said.num_row_groups), self.most_rows)
        self._limit("columns", said.num_columns, MOST_COLUMNS)
        self._limit("unpacked bytes", unpacked, MOST_UNPACKED)
        self._unique([said.schema.column(k).path for k in range(said.num_columns)])
        types = self._unique(schema.names, schema.types)
        texts = [name for name in ("support",) if name in types and not pa.types.is_nested(types[name])]
        chosen = texts + [name for name, kind in types.items() if is_number(kind) and name not in texts]
        file = pyarrow.parquet.ParquetFile(pa.BufferReader(content), read_dictionary=texts)
        return types, file.read(columns=chosen, use_threads=False)

    def _csv(self, content: bytes) -> tuple[dict[str, pa.DataType], pa.Table]:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        self._limit("lines", content.count(b"\n"), self.most_rows + 1)
        widest = max(max(line.count(b","), line.count(b";")) for line in content.split(b"\n"))
        self._limit("columns", widest + 1, MOST_COLUMNS)
        content = plain_csv(self.path, content)
        # A single block makes pyarrow infer a column's type from all rows.
        options = pyarrow.csv.ReadOptions(use_threads=False, block_size=len(content) + 1)
        table = pyarrow.csv.read_csv(pa.BufferReader(content), read_options=options)
        return self._unique(table.column_names, table.schema.types), table

    def _limit(self, name: str, found: int, most: int) -> None:
        if found > most:
            raise InputError(f"{self.path}: found {found} {name}, expected at most {most}")

    def _unique(self, names: list[str], types: Sequence[pa.DataType] = ()) -> dict[str, pa.DataType]:
        if len(set(names)) < len(names):
            twice = sorted(name for name in set(names) if names.count(name) > 1)[0]
            raise InputError(f"{self.path}: found column '{shortened(twice)}' more than once")
        return dict(zip(names, types, strict=False))

    def __len__(self) -> int:
        return self.table.num_rows

    def has(self, name: str) -> bool:
        return name in self.types

    def require(self, names: Sequence[str], others: Sequence[str] = ()) -> None:
        """Refuse a table that lacks columns; `others` (or their first words) are not meant for one."""
        if missing := [name for name in names if not self.has(name)]:
            free = [name for name in self.types if name not in names and name.partition(".")[0] not in others]
            near = dict.fromkeys(close for name in missing for close in close_to(name, free)[:1])
            found = f" (found {listed(map(repr, near))})" if near else ""
            lacks = listed(f"'{shortened(name)}'" for name in missing)
            are = f"column {lacks} is" if len(missing) == 1 else f"columns {lacks} are"
            raise IncompleteError(f"{self.path}: {are} missing{found}")

    def as_csv(self) -> bytes:
        """Return the table as `write_table` writes it; nothing if it has columns that are not read."""
        if set(self.types) != set(self.table.column_names):
            return b""
        schema = pa.schema(self.types.items())
        sink = pa.BufferOutputStream()
        pyarrow.csv.write_csv(self.table.select(list(self.types)).cast(schema), sink)
        return sink.getvalue().to_pybytes()

    def _type(self, name: str) -> pa.DataType:
        self.require([name])
        return self.types[name]

    def numbers(
        self, name: str, missing_allowed: bool = False, low: float = -math.inf, high: float = math.inf
    ) -> np.ndarray:
        """Return a column of finite numbers in [low, high], (m,); NaN for allowed missing values."""
        if missing_allowed and not self.has(name):
            return np.full(len(self), np.nan)
        kind = self._type(name)
        if pa.types.is_null(kind) and missing_allowed:
            return np.full(len(self), np.nan)
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
            raise InputError(
                f"{self.path}: column '{name}': found {kind}, expected numbers{self._first_text(name)}"
            )
        # Not by `to_numpy`, which loads pandas for a quarter of a second.
        column = self.table.column(name).combine_chunks()
        values = np.array(column.to_pylist() if column.null_count else np.from_dlpack(column), float)
        missing = np.isnan(values) & missing_allowed
        refuse_rows(self.path, name, ~(np.isfinite(values) | missing), values, "a finite number")
        outside = (values < low) | (values > high)
        refuse_rows(self.path, name, outside, values, f"a number within [{low:g}, {high:g}]")
        return values

    def _first_text(self, name: str) -> str:
        """Return the first row that holds no number, as text for a message."""
        if name in self.table.column_names and pa.types.is_string(self.types[name]):
            for row, value in enumerate(self.table.column(name).to_pylist(), 1):
                try:
                    float(value or "nan")
                except ValueError:
                    return f" (row {row}: {shortened(repr(value), 40)})"
        return ""

    def integers(self, name: str) -> np.ndarray:
        """Return a column of integers that a float represents exactly, (m,)."""
        values = self.numbers(name)
        broken = (values != np.round(values)) | (np.abs(values) >= 2**53)
        refuse_rows(self.path, name, broken, values, "a whole number below 2^53")
        return values.astype(np.int64)

    def texts(self, name: str, valid: tuple[str, ...]) -> np.ndarray:
        """Return a column of texts, all of them in `valid`, (m,)."""
        kind = self._type(name)
        if name not in self.table.column_names:
            raise InputError(f"{self.path}: column '{name}': found {kind}, expected texts")
        column = self.table.column(name).dictionary_encode().combine_chunks()
        known = column.dictionary.to_pylist()
        values = [None if number is None else known[number] for number in column.indices.to_pylist()]
        for row, value in enumerate(values, 1):
            if value not in valid:
                raise InputError(
                    f"{self.path}: column '{name}', row {row}: found {shortened(repr(value))}, "
                    f"expected one of {', '.join(valid)}"
                )
        return np.array(values)

    def matrix(
        self,
        prefix: str,
        names: tuple[str, ...],
        missing_allowed: bool = False,
        low: float = -math.inf,
        high: float = math.inf,
    ) -> np.ndarray:
        """Return the columns PREFIX.NAME side by side, (m, len(names))."""
        columns = [self.numbers(f"{prefix}.{name}", missing_allowed, low, high) for name in names]
        return np.column_stack(columns)


def is_number(kind: pa.DataType) -> bool:
    return pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind)


@cache
def software() -> dict[str, str]:
    """Return the versions of the packages that computed a result."""
    versions = {}
    for package in ("tulip-testbed", "mujoco", "mink", "numpy", "scipy", "pyarrow"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return versions
