"""A table's values: impossible, empty, repeated, useless."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from tests.fuzz.cases import (
    Expected,
    Rng,
    columns_of,
    is_plan,
    load_table,
    measurements_only,
    mutation,
    pick,
    refused,
    same,
    set_all,
    store,
    values_of,
    with_column,
)


@mutation
def poison_a_cell(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name, row = pick(rng, columns_of(table, "needed")), int(rng.integers(len(table)))
    values = values_of(table, name)
    values[row] = pick(rng, (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e308, None))
    path = store(folder, with_column(table, name, values), rng)
    return refused(path.name, f"column '{name}'", f"row {row + 1}")


@measurements_only
def empty_cells_where_allowed(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name = pick(rng, columns_of(table, "may_miss"))
    values = values_of(table, name)
    for row in rng.integers(0, len(values), 5):
        values[row] = pick(rng, (None, np.nan))
    store(folder, with_column(table, name, values), rng)
    return same()


@measurements_only
def poison_where_empty_is_allowed(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name, row = pick(rng, columns_of(table, "may_miss")), int(rng.integers(len(table)))
    values = [float(v) for v in values_of(table, name)]
    values[row] = pick(rng, (np.inf, -np.inf, 1e300, -1e300))
    path = store(folder, with_column(table, name, values), rng)
    return refused(path.name, f"column '{name}'", f"row {row + 1}")


@measurements_only
def negative_where_it_cannot_be(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name = pick(rng, [n for n in columns_of(table, "may_miss") if n != "time"])
    values = [float(v) for v in values_of(table, name)]
    row = int(rng.integers(len(values)))
    values[row] = pick(rng, (-1.0, -1e-9, -30.0))
    path = store(folder, with_column(table, name, values), rng)
    return refused(path.name, f"column '{name}'", f"row {row + 1}")


@mutation
def tiny_values(folder: Path, rng: Rng) -> Expected:
    """Subnormal numbers are numbers."""
    table = load_table(folder)
    names = [n for n in columns_of(table, "needed") if n.startswith("q.") and "knee" not in n]
    name, row = pick(rng, names), int(rng.integers(len(table)))
    values = values_of(table, name)
    values[row] = pick(rng, (5e-324, -5e-324, 1e-300, -0.0, 0))
    store(folder, with_column(table, name, [float(v) for v in values]), rng)
    return Expected("accepted")


@measurements_only
def tiny_spreads(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name = pick(rng, [n for n in columns_of(table, "may_miss") if n != "samples"])
    values = [float(v) for v in values_of(table, name)]
    for row in rng.integers(0, len(values), 5):
        values[row] = pick(rng, (0.0, 5e-324, 1e-300, 1e-160))
    if name == "time":  # the same posture at the same time would be another mutation
        values = [1e-300 * k for k in range(len(values))]
    store(folder, with_column(table, name, values), rng)
    return same()


@measurements_only
def equal_readings(folder: Path, rng: Rng) -> Expected:
    """Every posture weighs the same to the last bit."""
    table = load_table(folder)
    for plate, force in (("right", 20.0), ("left", 36.25)):
        table = set_all(table, f"cell.{plate}", lambda v, force=force: 0 * v + force)
    store(folder, table, rng)
    return Expected("accepted")


@mutation
def wrong_numbers_of_postures(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    name, row = pick(rng, ("posture", "placement")), int(rng.integers(len(table)))
    values: list[Any] = values_of(table, name)
    values[row] = pick(rng, (0.5, 2.0**53, -1e300, np.nan, None))
    if values[row] is not None:
        values = [float(v) for v in values]
    path = store(folder, with_column(table, name, values), rng)
    return refused(path.name, f"column '{name}'", f"row {row + 1}")


@mutation
def wrong_support(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    values, row = values_of(table, "support"), int(rng.integers(len(table)))
    values[row] = pick(rng, ("both", "Double", "double ", "dOuble", "x" * 100_000, "\x1b[2J", "ä"))
    path = store(folder, with_column(table, "support", values), rng)
    if values[row] == "double " and path.suffix == ".csv":
        return same()  # spreadsheets leave blanks around what they export
    return refused(path.name, "column 'support'", f"row {row + 1}")


@mutation
def support_of_another_type(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    rows = len(table)
    made = pick(
        rng,
        [
            pa.array([1] * rows),
            pa.nulls(rows),
            pa.array([b"double"] * rows),
            pa.array([["double"]] * rows),
            pa.array([True] * rows),
            pa.array([{"a": "double", "b": 1}] * rows),
        ],
    )
    path = store(folder, with_column(table, "support", made), rng, "parquet")
    return refused(path.name, "column 'support'")


@measurements_only
def one_foot_only(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    values, row = values_of(table, "support"), int(rng.integers(len(table)))
    values[row] = pick(rng, ("right", "left"))
    store(folder, with_column(table, "support", values), rng)
    if values[row] == "right":  # while both feet stand: nothing tells the 26th parameter
        return refused("left_foot.z")
    return refused("column 'support'", f"row {row + 1}", "expected 'double' or 'right'")


@mutation
def swap_rows(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    store(folder, table.take(rng.permutation(len(table))), rng)
    return same()


@mutation
def drop_some_rows(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    store(folder, table.take(np.sort(rng.choice(len(table), len(table) - 2, replace=False))), rng)
    return Expected("accepted")


@mutation
def repeat_a_row(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    again = table.slice(int(rng.integers(len(table))), 1)
    if "swing.x" in table.column_names:  # a plan may repeat a posture, but not give two the same number
        column = table.column_names.index("swing.x")
        again = again.set_column(column, "swing.x", pa.array([again["swing.x"][0].as_py() + 1e-3]))
    path = store(folder, pa.concat_tables([table, again]), rng)
    return refused(path.name, "column 'posture'")


@mutation
def too_few_rows(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    store(folder, table.slice(0, int(rng.integers(1, 13))), rng)
    return refused("postures", "base parameters")


@mutation
def no_rows(folder: Path, rng: Rng) -> Expected:
    path = store(folder, load_table(folder).slice(0, 0), rng)
    return refused(path.name, "found no rows")


@mutation
def too_many_rows(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    path = store(folder, pa.concat_tables([table] * (10_001 // len(table) + 1)), rng)
    return refused(path.name, "expected at most")


@mutation
def too_many_columns(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    one = pa.array(np.zeros(len(table)))
    extra = pa.table({f"note{k}": one for k in range(int(rng.integers(1_000, 3_000)))})
    for name in table.column_names:
        extra = extra.append_column(name, table.column(name))
    path = store(folder, extra, rng)
    return refused(path.name, "columns, expected at most")


@mutation
def degrees_for_radians(folder: Path, rng: Rng) -> Expected:
    path = store(folder, set_all(load_table(folder), "q.", np.rad2deg), rng)
    return refused(path.name, "column 'q.", "row ")


@measurements_only
def millimetres_for_metres(folder: Path, rng: Rng) -> Expected:
    path = store(folder, set_all(load_table(folder), "plate.", lambda v: 1000 * v), rng)
    return refused(path.name, "column 'plate.", "row ")


@measurements_only
def a_row_without_weight(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    row, factor = int(rng.integers(len(table))), pick(rng, (0.0, -1.0, 1e-6, 1e-300))

    def change(values: np.ndarray) -> np.ndarray:
        values[row] *= factor
        return values

    path = store(folder, set_all(table, "cell.", change), rng)
    return refused(path.name, f"row {row + 1}", "weight")


@measurements_only
def forces_that_cancel(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    table = set_all(table, "cell.right", lambda v: np.full_like(v, 100.0))
    path = store(folder, set_all(table, "cell.left", lambda v: np.full_like(v, -99.8)), rng)
    return refused(path.name, "row 1", "weight")


@mutation
def all_postures_the_same(folder: Path, rng: Rng) -> Expected:
    noise = 0.0 if is_plan(folder) else 4e-4
    table = set_all(
        load_table(folder), "q.", lambda v: np.full_like(v, v[0]) + noise * rng.standard_normal(len(v))
    )
    store(folder, table, rng)
    return refused("not determined separately", "torso.x (1)", folder.name)


@mutation
def a_joint_that_never_moved(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    joint = pick(rng, ("right_ankle_roll", "left_ankle_roll", "right_knee", "left_hip_pitch"))
    noise = 0.0 if is_plan(folder) else 4e-4
    table = set_all(
        table, f"q.{joint}", lambda v: np.full_like(v, v.mean()) + noise * rng.standard_normal(len(v))
    )
    store(folder, table, rng)
    return refused("not determined separately", "(free:", folder.name)


@measurements_only
def one_placement_for_all(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    store(folder, with_column(table, "placement", [7] * len(table)), rng)
    return same()


@measurements_only
def a_placement_for_each(folder: Path, rng: Rng) -> Expected:
    table = load_table(folder)
    store(folder, with_column(table, "placement", -np.arange(len(table)) * 10**9), rng)
    return same()


@measurements_only
def readings_without_any_error(folder: Path, rng: Rng) -> Expected:
    """Plates in one place and equal forces: the centre of pressure is the same point always."""
    table = set_all(load_table(folder), "plate.", lambda v: 0 * v)
    store(folder, set_all(table, "cell.", lambda v: 0 * v + 25.0), rng)
    return Expected("accepted")
