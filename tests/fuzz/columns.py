"""A table's columns: missing, renamed, of another type."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from tests.fuzz.cases import (
    Expected,
    Rng,
    columns_of,
    load_table,
    measurements_only,
    mutation,
    pick,
    refused,
    same,
    store,
    values_of,
    with_column,
)


@mutation
def drop_column(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    needed = ["posture", "placement", *columns_of(table, "needed")]
    name = pick(rng, needed)
    path = store(folder, table.drop_columns([name]), rng)
    measured = any(column.startswith("cell.") for column in table.column_names)
    may_lack = name in ("support", "time", "window", "samples") or name.startswith(("q_std.", "cell_std."))
    return same() if measured and may_lack else refused(path.name, f"column '{name}' is missing")


@measurements_only
def drop_columns_that_may_lack(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    names = ["support", *columns_of(table, "may_miss")]
    store(folder, table.drop_columns(list(rng.choice(names, 5, replace=False))), rng)
    return same()


@measurements_only
def drop_some_optional_columns(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    prefix = pick(rng, ("q_command.", "motor."))
    names = [n for n in table.column_names if n.startswith(prefix)]
    gone = names if rng.random() < 0.5 else [pick(rng, names)]
    path = store(folder, table.drop_columns(gone), rng)
    return same() if gone == names else refused(path.name, f"column '{gone[0]}' is missing")


@mutation
def rename_column(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name = pick(rng, columns_of(table, "needed"))
    new = pick(rng, ("", " ", name.upper(), "q", "ä", "\x1b[31m", "a" * 10_000))
    path = store(folder, table.rename_columns([new if n == name else n for n in table.column_names]), rng)
    return refused(path.name, f"column '{name}' is missing")


@mutation
def shuffle_columns(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    store(folder, table.select([table.column_names[k] for k in rng.permutation(table.num_columns)]), rng)
    return same()


@mutation
def extra_column(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    rows = len(table)
    values, suffix = pick(
        rng,
        [
            (pa.array(rng.standard_normal(rows)), None),
            (pa.array(["note"] * rows), None),
            (pa.array([None] * rows), None),
            (pa.array([True] * rows), None),
            (pa.array([b"\xff"] * rows), "parquet"),
            (pa.array([[1.0, 2.0]] * rows), "parquet"),
            (pa.array([{"a": 1, "b": "x"}] * rows), "parquet"),
            (pa.array([np.inf] * rows), None),
            (pa.array(["one long text " * 1000] * rows).dictionary_encode(), "parquet"),
        ],
    )
    store(folder, table.append_column(pick(rng, ("note", "q", "q.nose", "temperature")), values), rng, suffix)
    return same()


@mutation
def repeat_column(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name = pick(rng, table.column_names)
    path = store(folder, table.append_column(name, table.column(name)), rng)
    return refused(path.name, f"found column '{name}' more than once")


@mutation
def cast_column(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name = pick(rng, columns_of(table, "needed"))
    values = np.array(values_of(table, name), float)
    made, fine = pick(
        rng,
        [
            (pa.array(values.astype(np.float32)), True),
            (pa.array(values.astype(np.float16)), True),
            (pa.array([str(v) for v in values]), False),
            (pa.array([f"{v} rad" for v in values]), False),
            (pa.array(values > 0), False),
            (pa.array([b"\xff\xfe"] * len(values)), False),
            (pa.array([[v] for v in values]), False),
            (pa.array([{"x": v} for v in values]), False),
            (pa.array(values).dictionary_encode(), True),
            (pa.array(np.round(values * 1000).astype(np.int64)).cast(pa.timestamp("s")), False),
            (pa.array([f"{v:.6f}" for v in values]).cast(pa.decimal128(20, 6)), False),
            (pa.nulls(len(values)), False),
        ],
    )
    path = store(folder, with_column(table, name, made), rng, "parquet")
    # Rounded to half precision, a planned angle may leave its joint's range.
    return (
        Expected("either", (path.name,))
        if fine
        else refused(path.name, f"column '{name}'", "expected numbers")
    )


@mutation
def whole_numbers_of_another_width(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name = pick(rng, ("posture", "placement"))
    kind = pick(rng, (np.int16, np.uint32, np.float64, np.float32))
    store(folder, with_column(table, name, np.array(values_of(table, name)).astype(kind)), rng)
    return same()
