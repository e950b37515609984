"""Unusual and broken samples of a motion, and what has to come of each."""

import numpy as np
import pyarrow as pa
from hypothesis import strategies as st

from tests.fuzz import changes
from tests.fuzz.changes import REFUSED, RIGHT, SAME, WHOLE, Change, Draw, Expected, one, refused
from tests.fuzz.documents import put
from tests.fuzz.folders import CONTENTS, EDITS, Edit, cells, flipped_footer, garbage, typed, whole

TABLE = "motion.parquet"
NEEDED = ("segment", "time", "placement", "q.", "cell.", "plate.")


def drop_a_column(t: pa.Table, draw: Draw) -> pa.Table:
    return t.drop_columns([one(draw, [name for name in t.column_names if name.startswith(NEEDED)])])


def rows_out_of_order(t: pa.Table, draw: Draw) -> pa.Table:
    row = draw(st.integers(0, len(t) - 3))
    return t.take([*range(row), row + 2, row + 1, row, *range(row + 3, len(t))])


def gap(t: pa.Table, draw: Draw) -> pa.Table:
    row = draw(st.integers(100, len(t) - 500))
    return pa.concat_tables([t[:row], t[row + draw(st.integers(1, 400)) :]])


def lifted(share: float, load: float) -> Edit:
    """Give the right foot a part of its load in a share of the samples."""
    return whole({"cell.right": lambda v: np.where(np.arange(len(v)) < share * len(v), load * v, v)})


WINDOWS = (0, -1, 11, None, "0.5", [0.5])
TABLES: dict[str, tuple] = {
    "drop a column": (drop_a_column, REFUSED),
    "poisoned samples": (cells((np.nan, np.inf, -np.inf, 1e300, None), "q.", "cell.", "plate."), REFUSED),
    "poisoned times": (cells((np.nan, np.inf, -np.inf, None), "time"), REFUSED),
    "a time that stands": (whole({"time": lambda v: 0 * v}), refused("column 'time', row 2", "increases")),
    "a time that goes back": (whole({"time": lambda v: -v}), refused("column 'time', row 2", "increases")),
    "another epoch": (whole({"time": lambda v: v + 1.6e9}), RIGHT),
    "a slow clock": (whole({"time": lambda v: 1e6 * v}), refused(WHOLE, "no window")),
    "a fast clock": (whole({"time": lambda v: 1e-6 * v}), refused(WHOLE, "no window")),
    "an endless clock": (whole({"time": lambda v: 1e300 * v}), REFUSED),
    "rows out of order": (rows_out_of_order, refused("row ")),
    "shuffled rows": (lambda t, d: t.take(np.random.default_rng(1).permutation(len(t))), refused("row ")),
    "a gap": (gap, RIGHT),
    "wrong numbers": (cells((0.5, 2.0**53, np.nan, None), "segment", "placement"), REFUSED),
    "a segment each": (whole({"segment": lambda v: np.arange(len(v))}), refused(WHOLE, "no window")),
    "one segment": (whole({"segment": lambda v: 0 * v}), refused("row ", "begin a new one")),
    "wrong support": (cells(("both", "Double", "x" * 99_999, "ä"), "support"), REFUSED),
    "no texts": (typed(lambda v: [[1] * len(v), [None] * len(v)], "support"), REFUSED, "parquet"),
    "another support": (whole({"support": lambda v: ["left"] * len(v)}), Expected("either", (WHOLE,))),
    "a foot that lifts": (lifted(0.3, 0), RIGHT),
    "a foot in the air": (lifted(1.0, 0), refused(WHOLE, "no window")),
    "a foot that pulls": (lifted(1.0, -1), refused("row ")),
    "few samples": (lambda t, d: t[: d(st.integers(1, 90))], refused(WHOLE)),
    "no samples": (lambda t, d: t[:0], refused("found no rows")),
}
MOTION_KINDS: dict[str, Change] = {name: changes.table(*how) for name, how in TABLES.items()}
MOTION_KINDS |= {name: changes.table(*EDITS[name]) for name in ("no numbers", "shuffle the columns")}
MOTION_KINDS |= {
    "truncated table": changes.content(changes.truncated, REFUSED, TABLE),
    "flipped footer": changes.content(flipped_footer, Expected("either", (TABLE,)), TABLE),
    "another hash": changes.content(*CONTENTS["another hash"][:2], TABLE),
    "garbage for a table": changes.content(garbage, REFUSED, TABLE),
    "a window": changes.content(put("motion.window", 0.3, 0.5, 1.0, 2), RIGHT, "manifest.json"),
    "no window": changes.content(put("motion.window", *WINDOWS), refused("motion.window"), "manifest.json"),
    "too short a window": changes.content(
        put("motion.window", 1e-9), refused(WHOLE, "no window"), "manifest.json"
    ),
    "no entry of the motion": changes.content(put("motion", None), SAME, "manifest.json"),
    **{f"{kind} for a file": changes.stands(kind, TABLE) for kind in ("folder", "pipe", "closed", "loop")},
}
