"""The bytes of the tables: truncated, flipped, compressed beyond reason, of another dialect."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from tests.fuzz.cases import (
    Expected,
    Rng,
    load_table,
    mutation,
    pick,
    refused,
    rehash,
    same,
    store,
    values_of,
    with_column,
)


def _table_bytes(folder: Path, rng: Rng, suffix: str | None = None) -> Path:
    """One table alone in the folder."""
    return store(folder, load_table(folder), rng, suffix)


@mutation
def truncate_a_table(folder: Path, rng: Rng) -> Expected:
    path = _table_bytes(folder, rng)
    content = path.read_bytes()
    path.write_bytes(content[: int(rng.integers(0, len(content)))])
    if honest := rng.random() < 0.7:
        rehash(folder)
    return Expected("either", (path.name,)) if honest else refused(path.name, "hash mismatch")


@mutation
def flip_bytes_in_a_table(folder: Path, rng: Rng) -> Expected:
    path = _table_bytes(folder, rng)
    content = bytearray(path.read_bytes())
    for at in rng.integers(0, len(content), int(rng.integers(1, 9))):
        content[at] ^= int(rng.integers(1, 256))
    path.write_bytes(content)
    if honest := rng.random() < 0.8:
        rehash(folder)
    return Expected("either", ("postures",)) if honest else refused(path.name, "hash mismatch")


@mutation
def flip_bytes_in_the_footer(folder: Path, rng: Rng) -> Expected:
    """Where a Parquet file says how large everything is."""
    path = _table_bytes(folder, rng, "parquet")
    content = bytearray(path.read_bytes())
    footer = int.from_bytes(content[-8:-4], "little")
    for at in rng.integers(len(content) - footer - 8, len(content), int(rng.integers(1, 9))):
        content[at] ^= int(rng.integers(1, 256))
    path.write_bytes(content)
    rehash(folder)
    return Expected("either", ("postures",))


@mutation
def garbage_for_a_table(folder: Path, rng: Rng) -> Expected:
    path = _table_bytes(folder, rng)
    path.write_bytes(
        pick(rng, (b"", b"\n", b"PAR1", b"PAR1PAR1", b"\x00" * 100, rng.bytes(5_000), b"," * 50, b'"'))
    )
    rehash(folder)
    return refused(path.name)


@mutation
def an_edited_twin(folder: Path, rng: Rng) -> Expected:
    path = folder / f"postures.{pick(rng, ('csv', 'parquet'))}"
    path.write_bytes(path.read_bytes() + b"\n")
    return refused(path.name, "hash mismatch")


@mutation
def rows_that_take_no_space(folder: Path, rng: Rng) -> Expected:
    """A hundred million equal rows are a small Parquet file."""
    table = load_table(folder)
    rows = 10_000_000
    name = pick(rng, table.column_names)
    value = values_of(table, name)[0]
    kind = table.schema.field(name).type
    bomb = pa.table({name: pa.repeat(pa.scalar(value, kind), rows)})
    path = folder / "postures.parquet"
    (folder / "postures.csv").unlink()
    pyarrow.parquet.write_table(bomb, path, compression="zstd", row_group_size=rows)
    rehash(folder)
    return refused(path.name, "rows, expected at most")


@mutation
def a_table_that_unpacks_hugely(folder: Path, rng: Rng) -> Expected:
    """A quarter of a gigabyte behind less than a megabyte."""
    table = load_table(folder)
    texts = pa.array(["0" * (2**28 // len(table) + 1)] * len(table))
    path = folder / "postures.parquet"
    (folder / "postures.csv").unlink()
    pyarrow.parquet.write_table(
        table.append_column("note", texts), path, compression="zstd", use_dictionary=False
    )
    assert path.stat().st_size < 2**20
    rehash(folder)
    return refused(path.name, "unpacked bytes, expected at most")


@mutation
def a_long_text_in_every_row(folder: Path, rng: Rng) -> Expected:
    """A dictionary holds it once; a list of texts would hold it as often as there are rows."""
    table = load_table(folder)
    table = pa.concat_tables([table] * (9_000 // len(table)))
    texts = pa.DictionaryArray.from_arrays(pa.array(np.zeros(len(table), np.int32)), pa.array(["0" * 2**20]))
    path = folder / "postures.parquet"
    (folder / "postures.csv").unlink()
    pyarrow.parquet.write_table(with_column(table, "support", texts), path, compression="zstd")
    rehash(folder)
    return refused(path.name, "column 'support'", "row 1")


def _csv_text(folder: Path, rng: Rng) -> tuple[Path, str]:
    path = _table_bytes(folder, rng, "csv")
    return path, path.read_text()


def _write_csv(folder: Path, path: Path, content: str | bytes) -> None:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    rehash(folder)


@mutation
def csv_dialects_that_are_fine(folder: Path, rng: Rng) -> Expected:
    path, text = _csv_text(folder, rng)
    header, _, body = text.partition("\n")
    rows = list(csv.reader(io.StringIO(text)))
    quoted = io.StringIO()
    csv.writer(quoted, quoting=csv.QUOTE_ALL, lineterminator="\n").writerows([rows[0]])
    csv.writer(quoted, lineterminator="\n").writerows(rows[1:])
    made = pick(
        rng,
        [
            text.replace("\n", "\r\n"),
            "\ufeff" + text,
            text.rstrip("\n"),
            text + "\n\n\n",
            text.replace(",", ";"),
            text.replace(",", " , "),
            header.replace(",", ";") + "\n" + body.replace(",", ";").replace(".", ","),
            "# made by hand\n" + text,
            text + "," * text.splitlines()[0].count(",") + "\n",
            quoted.getvalue(),
            "\n".join(",".join(row) for row in rows) + "\n",
        ],
    )
    _write_csv(folder, path, made)
    return same()


@mutation
def csv_dialects_that_are_not(folder: Path, rng: Rng) -> Expected:
    path, text = _csv_text(folder, rng)
    lines = text.splitlines()
    middle = len(lines) // 2
    made = pick(
        rng,
        [
            text.replace(",", "\t"),
            text.encode("utf-16"),
            "\n".join([*lines[:middle], lines[middle] + ",1", *lines[middle + 1 :]]),
            "\n".join([*lines[:middle], lines[middle].rpartition(",")[0], *lines[middle + 1 :]]),
            "\n".join([lines[0], *lines]),
            "\n".join(lines[1:]),
            text.replace("double", "double\x00", 1),
            text.encode().replace(b"double", b"d\xff\xfeuble", 1),
            text.encode().replace(b"posture", b"post\xff\xfe", 1),
            text.replace('"double"', '"double', 1),
            ",".join(f"c{k}" for k in range(100_000)) + "\n" + text,
            text + "x" * 5_000_000,
            text.replace(",", ";").replace("0.", "0,", 1),
            " " * 1_000_000 + '"' + " " * 1_000_000 + text,
        ],
    )
    _write_csv(folder, path, made)
    return refused("postures.csv")
