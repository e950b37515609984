"""The runs of a Monte Carlo on disk: one Parquet file for every chunk of them, each whole or absent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import present, read_bytes, write_bytes
from tulip_testbed.base.table_files import MOST_UNPACKED, Columns

TEXT = "failure"  # the column of texts; all others hold numbers


@dataclass(frozen=True)
class RunChunks:
    """The runs 0 to `runs` - 1 in files of `size` runs.

    The files together are one table, in order; most readers of Parquet take the folder's name for it.
    """

    folder: Path
    runs: int
    size: int

    def __len__(self) -> int:
        return -(-self.runs // self.size)

    def runs_of(self, index: int) -> range:
        """Return the numbers of a chunk's runs."""
        return range(index * self.size, min((index + 1) * self.size, self.runs))

    def path(self, index: int) -> Path:
        """Return the file of a chunk."""
        return self.folder / f"chunk-{index:06d}.parquet"

    def missing(self) -> list[int]:
        """Return the chunks that are still to be computed."""
        return [index for index in range(len(self)) if not present(self.path(index))]

    def done(self) -> int:
        """Return how many runs are there."""
        return self.runs - sum(len(self.runs_of(index)) for index in self.missing())

    def write(self, columns: Columns) -> int:
        """Write the chunk that begins with the first of these runs; returns how many runs it holds."""
        index, runs = int(columns["run"][0]) // self.size, columns["run"].tolist()
        assert runs == list(self.runs_of(index)), f"chunk {index} holds runs {runs}"
        sink = pa.BufferOutputStream()
        pa.parquet.write_table(pa.table(columns), sink, use_dictionary=False, write_statistics=False)
        write_bytes(self.path(index), sink.getvalue().to_pybytes())
        return len(runs)

    def read(self, index: int, names: Sequence[str]) -> Columns:
        """Return the numbers of a chunk's runs and some more columns."""
        path, runs = self.path(index), self.runs_of(index)
        wanted = [*dict.fromkeys(["run", *names])]
        table = _table(path, wanted, len(runs))
        columns = {name: _column(path, name, table.column(name)) for name in wanted} if table else {}
        if not columns or not np.array_equal(columns["run"], runs):
            raise InputError(
                f"{path}: not the chunk of runs {runs[0]} to {runs[-1]}; remove it, and the same command "
                "makes it again"
            )
        return columns


def _table(path: Path, names: list[str], rows: int) -> pa.Table | None:
    """Return some columns of a file; None if it lacks one, has one twice, or has not as many rows."""
    try:
        with pa.parquet.ParquetFile(pa.BufferReader(read_bytes(path))) as file:
            there, said = file.schema_arrow.names, file.metadata
            if said.num_rows != rows or any(there.count(name) != 1 for name in names):
                return None
            groups = range(min(said.num_row_groups, rows))
            if sum(said.row_group(k).total_byte_size for k in groups) > MOST_UNPACKED:
                return None
            return file.read(columns=names)
    except (OSError, ValueError, pa.ArrowException) as error:  # ValueError: a name that is not UTF-8
        raise InputError(f"{path}: cannot read ({' '.join(str(error).split())[:200]})") from None


def _column(path: Path, name: str, column: pa.ChunkedArray) -> np.ndarray:
    """Return a column of numbers, or of texts if it is `TEXT`; refuse anything else."""
    kind, expected = column.type, "texts" if name == TEXT else "numbers"
    numbers = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    if not (pa.types.is_string(kind) if name == TEXT else numbers) or column.null_count:
        found = f"{column.null_count} rows without any" if column.null_count else kind
        raise InputError(f"{path}: column '{name}': found {shortened(found)}, expected {expected}")
    values = column.to_numpy()
    return values.astype(float) if pa.types.is_floating(kind) else values
