"""Unusual and broken measurement and plan folders, and what has to come of each."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
from hypothesis import strategies as st

from tests.fuzz import changes
from tests.fuzz.changes import EITHER, REFUSED, RIGHT, SAME, WHOLE, Change, Draw, Expected, one, refused
from tests.fuzz.documents import changed_anywhere, edited, fine_json, put, wrong_json

Edit = Callable[[pa.Table, Draw], pa.Table]
NEEDED = ("posture", "placement", "q.", "cell.", "plate.", "swing.")
MAY_MISS = ("q_std.", "cell_std.", "window", "samples", "time")
SEVERAL = ("q_command.", "motor.")  # that all may lack, but not one of them alone
CANCELLING: dict[str, Callable] = {"cell.right": lambda v: 0 * v + 100, "cell.left": lambda v: 0 * v - 99.8}
JSON, CSV, PARQUET = ("manifest.json", "plan.json"), "postures.csv", "postures.parquet"


def names(t: pa.Table, *prefixes: str) -> list[str]:
    return [name for name in t.column_names if name.startswith(prefixes)]


def exchanged(t: pa.Table, name: str, make: Callable[[np.ndarray], Any]) -> pa.Table:
    """Return the table with a column replaced by what is made of it."""
    return t.set_column(t.column_names.index(name), name, pa.array(make(np.array(t[name].to_pylist()))))


def whole(formulas: dict[str, Callable[[np.ndarray], Any]]) -> Edit:
    """Apply a formula to all columns of each prefix."""

    def edit(t: pa.Table, draw: Draw) -> pa.Table:
        for name, formula in [(name, formulas[prefix]) for prefix in formulas for name in names(t, prefix)]:
            t = exchanged(t, name, formula)
        return t

    return edit


def typed(make: Callable[[np.ndarray], list], *prefixes: str) -> Edit:
    """Replace one of the columns by one of the arrays that are made of it."""
    return lambda t, draw: exchanged(t, one(draw, names(t, *prefixes)), lambda v: one(draw, make(v)))


def cells(values: tuple, *prefixes: str) -> Edit:
    """Put a value into up to five rows of one of the columns."""

    def edit(t: pa.Table, draw: Draw) -> pa.Table:
        value, rows = one(draw, values), draw(st.sets(st.integers(0, len(t) - 1), min_size=1, max_size=5))
        return typed(lambda v: [[value if k in rows else x for k, x in enumerate(v.tolist())]], *prefixes)(
            t, draw
        )

    return edit


def other_numbers(v: np.ndarray) -> list:
    return [v.astype(np.float32), v.astype(np.float16), pa.array(v).dictionary_encode()]


def no_numbers(v: np.ndarray) -> list:
    times = pa.array(np.round(v * 1000).astype(np.int64)).cast(pa.timestamp("s"))
    decimals = pa.array([f"{x:.6f}" for x in v]).cast(pa.decimal128(20, 6))
    texts = [str(x) for x in v], [f"{x} rad" for x in v], [b"\xff\xfe"] * len(v)
    return [*texts, v > 0, [[x] for x in v], [{"x": x} for x in v], times, decimals, pa.nulls(len(v))]


def extra(*values: Any) -> Edit:
    labels = ("note", "q", "q.nose", "temperature")
    return lambda t, draw: t.append_column(one(draw, labels), pa.array([one(draw, values)] * len(t)))


def rename(t: pa.Table, draw: Draw) -> pa.Table:
    name = one(draw, names(t, *NEEDED))
    return t.rename_columns({name: one(draw, ("", " ", name.upper(), "q", "ä", "\x1b[31m", "a" * 10_000))})


def drop_what_may_lack(t: pa.Table, draw: Draw) -> pa.Table:
    return t.drop_columns(names(t, one(draw, ("support", *SEVERAL, *MAY_MISS))))


def too_many_columns(t: pa.Table, draw: Draw) -> pa.Table:
    return pa.table({f"note{k}": np.zeros(len(t)) for k in range(draw(st.integers(1_001, 3_000)))})


def without_weight(t: pa.Table, draw: Draw) -> pa.Table:
    row, factor = draw(st.integers(0, len(t) - 1)), one(draw, (0.0, -1.0, 1e-6, 1e-300))
    return whole({"cell.": lambda v: np.where(np.arange(len(v)) == row, factor * v, v)})(t, draw)


def long_texts(t: pa.Table, draw: Draw) -> pa.Table:
    """Put one long text in every row: a dictionary holds it once, a list of texts 9,000 times."""
    texts = pa.DictionaryArray.from_arrays(pa.array(np.zeros(9_000, np.int32)), pa.array(["0" * 2**20]))
    return whole({"support": lambda v: texts})(pa.concat_tables([t] * 300)[:9_000], draw)


def wrong_csv(text: str, draw: Draw) -> list:
    first, row, *rest = text.splitlines()
    rows = ["\n".join([first, bad, *rest]) for bad in (row + ",1", row.rpartition(",")[0], first)]
    wide, blank = ",".join(f"c{k}" for k in range(100_000)), " " * 1_000_000
    separated = text.replace(",", "\t"), text.replace(",", ";").replace("0.", "0,", 1)
    return [*rows, *separated, f"{wide}\n{text}", f'{blank}"{blank}{text}', f"{row}\n{text}"]


def garbage(old: Any, draw: Draw) -> list:
    return [b"", b"\n", b"PAR1", b"PAR1PAR1", b"\x00" * 100, b"," * 50, b'"', draw(st.binary(max_size=5_000))]


def flipped_footer(old: bytes, draw: Draw) -> list:
    """Change the part of a Parquet file that says how large everything is."""
    return changes.flipped(old, draw, len(old) - 8 - int.from_bytes(old[-8:-4], "little"))


MANY = 10_000_000
NO_TEXTS = (1, None, b"double", ["double"], True, {"a": "double", "b": 1})
TOLERANCES = (None, {}, {"tilt": 0}, {"encoder-offset": 1e-3, "link-length": 1e-12})
SHEET = (None, 0.0, 0, 1e-12, 0.1)  # of the same sensors, so that the estimates stay
IN_TABLE, ANYWHERE = Expected("either", ("/postures.",)), Expected("either", (WHOLE,))
EDITS: dict[str, tuple] = {  # of tables: what has to come of it, in which format if not in either
    "drop a column": (lambda t, d: t.drop_columns([one(d, names(t, *NEEDED))]), REFUSED),
    "rename a column": (rename, REFUSED),
    "repeat a column": (lambda t, d: t.select([*t.column_names, one(d, t.column_names)]), REFUSED),
    "shuffle the columns": (lambda t, d: t.select(d(st.permutations(t.column_names))), SAME),
    "extra column": (extra(0.5, "note", None, True, np.inf, "long text " * 1000), SAME),
    "extra column, nested": (extra(b"\xff", [1.0, 2.0], {"a": 1, "b": "x"}), SAME, "parquet"),
    "too many columns": (too_many_columns, refused("columns, expected at most")),
    "other numbers": (typed(other_numbers, *NEEDED[2:]), EITHER, "parquet"),
    "no numbers": (typed(no_numbers, *NEEDED), REFUSED, "parquet"),
    "wider whole numbers": (typed(lambda v: [v.astype(k) for k in "hIdf"], *NEEDED[:2]), SAME),
    "no texts": (typed(lambda v: [[x] * len(v) for x in NO_TEXTS], "support"), REFUSED, "parquet"),
    "poisoned cells": (cells((np.nan, np.inf, -np.inf, 1e300, -1e300, None), *NEEDED[2:]), REFUSED),
    "tiny angles": (cells((5e-324, -5e-324, 1e-300, -0.0, 0), "q."), RIGHT),
    "wrong numbers of postures": (cells((0.5, 2.0**53, -1e300, np.nan, None), *NEEDED[:2]), REFUSED),
    "wrong support": (cells(("both", "Double", "x" * 100_000, "\x1b[2J", "ä"), "support"), REFUSED),
    "support with a blank": (cells(("double ",), "support"), REFUSED, "parquet"),
    "swap rows": (lambda t, d: t.take(d(st.permutations(range(len(t))))), SAME),
    "drop rows": (lambda t, d: t.take(sorted(d(st.permutations(range(len(t))))[2:])), RIGHT),
    "too few rows": (lambda t, d: t[: d(st.integers(1, 12))], refused(WHOLE, "base parameters")),
    "too many rows": (lambda t, d: pa.concat_tables([t] * 400), refused("expected at most")),
    "long texts": (long_texts, refused("column 'support'", "row 1"), "parquet"),
}
MEASURED_EDITS: dict[str, tuple] = {
    "drop what may lack": (drop_what_may_lack, SAME),
    "drop one of several": (lambda t, d: t.drop_columns([one(d, names(t, *SEVERAL))]), REFUSED),
    "empty cells": (cells((None, np.nan), *MAY_MISS), SAME),
    "poison for empty cells": (cells((np.inf, -np.inf, 1e300, -1e300), *MAY_MISS), REFUSED),
    "negative spreads": (cells((-1.0, -1e-9, -30.0), *MAY_MISS[:-1]), REFUSED),
    "tiny spreads": (cells((0.0, 5e-324, 1e-300, 1e-160), *MAY_MISS[:-2]), SAME),
    "tiny times": (whole({"time": lambda v: 1e-300 * np.arange(len(v))}), SAME),
    "left foot only": (cells(("left",), "support"), refused(WHOLE, "right_foot.z")),
    "right foot only": (cells(("right",), "support"), refused(WHOLE, "left_foot.z")),
    "equal readings": (whole({"cell.r": lambda v: 0 * v + 20, "cell.l": lambda v: 0 * v + 36.25}), RIGHT),
    "no error at all": (whole({"plate.": lambda v: 0 * v, "cell.": lambda v: 0 * v + 25}), RIGHT),
    "a row without weight": (without_weight, refused("row ", "weight")),
    "forces that cancel": (whole(CANCELLING), refused("row 1", "weight")),
    "one placement": (whole({"placement": lambda v: 0 * v + 7}), SAME),
    "a placement for each": (whole({"placement": lambda v: -np.arange(len(v)) * 10**9}), SAME),
}
CONTENTS: dict[str, tuple] = {  # of files: what has to come of it, of which file
    "truncated table": (changes.truncated, ANYWHERE, CSV, PARQUET),
    "flipped bytes": (changes.flipped, IN_TABLE, CSV, PARQUET),
    "flipped footer": (flipped_footer, IN_TABLE, PARQUET),
    "garbage for a table": (garbage, REFUSED, CSV, PARQUET),
    "spoiled CSV": (changes.spoiled, REFUSED, CSV),
    "wrong CSV": (wrong_csv, REFUSED, CSV),
    "harmless CSV": (changes.harmless, SAME, CSV),
    "a JSON key lost or any value": (edited(changed_anywhere), ANYWHERE, *JSON),
    "truncated JSON": (changes.truncated, REFUSED, *JSON),
    "spoiled JSON": (changes.spoiled, REFUSED, *JSON),
    "wrong JSON": (wrong_json, REFUSED, *JSON),
    "harmless JSON": (changes.harmless, SAME, *JSON),
    "fine JSON": (fine_json, SAME, *JSON),
}
MEASURED_CONTENTS: dict[str, tuple] = {
    "no weighed mass": (put("weighed_mass", None), SAME, JSON[0]),
    "cell spread": (put("sensors.cell_sd", *SHEET), SAME, JSON[0]),
    "cell resolution": (put("sensors.cell_resolution", *SHEET), SAME, JSON[0]),
    "encoder resolution": (put("sensors.encoder_resolution", *SHEET), SAME, JSON[0]),
    "tolerances": (put("tolerances", *TOLERANCES), SAME, JSON[0]),
    "placement spread": (put("sensors.placement_sd", None, *([x] * 3 for x in SHEET[1:])), SAME, JSON[0]),
}
TINY = "tiny angles"
PLAN_KINDS: dict[str, Change] = {
    **{name: changes.table(*how) for name, how in EDITS.items()},
    TINY: changes.table(EDITS[TINY][0], Expected("either", ("row ",))),
    **{name: changes.content(*how) for name, how in CONTENTS.items()},
    **{f"{kind} for a file": changes.stands(kind, *JSON, CSV, PARQUET) for kind in (*changes.PLACES, "link")},
    "rows that take no space": changes.table(
        lambda t, d: pa.table({"posture": pa.repeat(one(d, (1, 0.5, "x")), MANY)}),
        *(refused("rows, expected at most"), "parquet"),
        compression="zstd",
        row_group_size=MANY,
    ),
    "a table that unpacks hugely": changes.table(
        lambda t, d: extra(one(d, "0x ") * (2**28 // len(t) + 1))(t, d),
        *(refused("unpacked bytes, expected at most"), "parquet"),
        compression="zstd",
        use_dictionary=False,
    ),
}
MEASUREMENT_KINDS: dict[str, Change] = {
    **PLAN_KINDS,
    TINY: changes.table(*EDITS[TINY]),
    **{name: changes.table(*how) for name, how in MEASURED_EDITS.items()},
    **{name: changes.content(*how) for name, how in MEASURED_CONTENTS.items()},
}
