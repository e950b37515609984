"""Results on disk: one Parquet file for every chunk of runs, each whole or absent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.files import present, read_bytes, write_bytes
from tulip_testbed.sim.measurements.table_files import Columns


@dataclass(frozen=True)
class Chunks:
    """The runs 0 to `runs` - 1 in files of `size` runs.

    The files together are one table, in order; most readers of Parquet take the folder's name for it.
    """

    folder: Path
    runs: int
    size: int

    def __len__(self) -> int:
        return -(-self.runs // self.size)

    def runs_of(self, index: int) -> range:
        return range(index * self.size, min((index + 1) * self.size, self.runs))

    def path(self, index: int) -> Path:
        return self.folder / f"chunk-{index:06d}.parquet"

    def missing(self) -> list[int]:
        """Chunks that are still to be computed."""
        return [index for index in range(len(self)) if not present(self.path(index))]

    def write(self, columns: Columns) -> int:
        """Write the chunk that begins with the first of these runs; returns how many runs it holds.

        Raises:
            InputError: it cannot be written.
        """
        index, runs = int(columns["run"][0]) // self.size, columns["run"].tolist()
        assert runs == list(self.runs_of(index)), f"chunk {index} holds runs {runs}"
        sink = pa.BufferOutputStream()
        pa.parquet.write_table(pa.table(columns), sink, use_dictionary=False, write_statistics=False)
        write_bytes(self.path(index), sink.getvalue().to_pybytes())
        return len(runs)

    def read(self, names: list[str]) -> Iterator[Columns]:
        """Some columns, chunk by chunk in order.

        Raises:
            InputError: a file is missing or damaged.
        """
        for index in range(len(self)):
            yield self.read_one(index, names)

    def read_one(self, index: int, names: list[str]) -> Columns:
        """Some columns of one chunk.

        Raises:
            InputError: the file is missing or damaged.
        """
        path = self.path(index)
        try:
            with pa.parquet.ParquetFile(pa.BufferReader(read_bytes(path))) as file:
                table = file.read(columns=[*dict.fromkeys(["run", *names])])
            columns = {name: table.column(name).to_numpy() for name in table.column_names}
            whole = not set(names) - set(columns)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{path}: cannot read ({' '.join(str(error).split())[:200]})") from None
        if not whole or not np.array_equal(columns["run"], self.runs_of(index)):
            runs = self.runs_of(index)
            raise InputError(
                f"{path}: not the chunk of runs {runs[0]} to {runs[-1]}; remove it, and the same command "
                "makes it anew"
            )
        return columns
