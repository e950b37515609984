"""Edited run and Monte Carlo folders, and what has to come of each.

Whoever edits also lists the new hashes, so that they do not betray it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from tests.fuzz import changes, documents, folders
from tests.fuzz.changes import (
    EITHER,
    REFUSED,
    RIGHT,
    SAME,
    WHOLE,
    Change,
    Draw,
    Expected,
    Make,
    content,
    one,
    refused,
)
from tests.fuzz.documents import edited, put

RUN, RESULT, REPORT, TRUTH = "run.json", "result.json", "report.json", "truth.json"
CHUNK = "runs/chunk-000000.parquet"


def sealed(change: Change) -> Change:
    """List the files' new hashes in run.json after a change."""

    def both(folder: Path, draw: Draw) -> Expected:
        expected = change(folder, draw)
        with suppress(ValueError, OSError, TypeError, KeyError, AttributeError):  # nothing that lists hashes
            document = json.loads((folder / RUN).read_text())
            old = document["outputs"]
            new = {name: hash_of(folder / name, known) for name, known in old.items()}
            if new != old:
                (folder / RUN).write_text(json.dumps(document | {"outputs": new}))
        return expected

    return both


def hash_of(path: Path, known: Any) -> Any:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else known


def documents_of(*files: str) -> dict[str, Change]:
    """Return the kinds of change that any JSON file bears."""
    kinds: dict[str, tuple[Make, Expected]] = {
        **{name: (edited(edit), EITHER) for name, edit in documents.EDITS.items()},
        "no number": (documents.no_number, REFUSED),
        "truncated JSON": (changes.truncated, REFUSED),
        "spoiled JSON": (changes.spoiled, REFUSED),
        "flipped bytes": (changes.flipped, EITHER),
        "harmless JSON": (changes.harmless, SAME),
    }
    return {
        f"{kind} in {file}": sealed(content(make, expected, file))
        for file in files
        for kind, (make, expected) in kinds.items()
    }


def others(*files: str) -> dict[str, Change]:
    """Return what may stand in the place of a folder or of one of its files."""
    kinds = [kind for kind in (*changes.PLACES, "link") if kind != "nothing"]
    return {f"{kind} for a file": changes.stands(kind, *files) for kind in kinds}


def without(expected: Expected, file: str) -> Change:
    """Remove a file."""

    def change(folder: Path, draw: Draw) -> Expected:
        (folder / file).unlink()
        return expected

    return change


def residuals(expected: Expected, *makes: Make) -> Change:
    return sealed(content(lambda text, draw: one(draw, makes)(text, draw), expected, "residuals.csv"))


def no_residuals(text: str, draw: Draw) -> list:
    first, row, *rest = text.splitlines()
    number = row.rpartition(",")[2]
    bad = [text.replace(number, value, 1) for value in ("", "x", "nan", "inf", "-inf", "1e400")]
    return [
        *bad,
        first,
        "\n".join([first, *rest]),
        "\n".join([row, *rest]),
        "\n".join([first, row, row, *rest]),
    ]


# --- tables of runs ----------------------------------------------------------------------------


def runs(edit: folders.Edit, expected: Expected) -> Change:
    """Edit the table of a Monte Carlo's runs."""

    def change(folder: Path, draw: Draw) -> Expected:
        path = folder / CHUNK
        intact = pyarrow.parquet.read_table(path)
        pyarrow.parquet.write_table(edit(intact, draw), path)
        return changes.named(expected, path)

    return change


def failed(*reasons: str) -> folders.Edit:
    """Let one of the runs have failed."""

    def edit(t: pa.Table, draw: Draw) -> pa.Table:
        row, reason = one(draw, range(len(t))), one(draw, reasons)
        return folders.exchanged(t, "failure", lambda v: [reason if k == row else "" for k in range(len(t))])

    return edit


def renamed(t: pa.Table, draw: Draw) -> pa.Table:
    name = one(draw, folders.names(t, *READ))
    return t.rename_columns({name: one(draw, ("", name.upper(), "\x1b[31m", "a" * 10_000))})


VALUES = ("truth.", "full.value.", "full.se.", "mass", "true_mass")
READ = (*VALUES, "run", "failure", "full.dof.", "full.sigma", "simplified.value.", "rows", "dropped")
Formula = Callable[[np.ndarray], Any]
BETTER: dict[str, Formula] = {"full.value.": lambda v: v + 1e-3}
WORSE: dict[str, Formula] = {"full.se.": lambda v: v / 3, "full.dof.": lambda v: v + 2}
TABLE_EDITS: dict[str, tuple[folders.Edit, Expected]] = {
    "drop a column": (lambda t, d: t.drop_columns([one(d, folders.names(t, *READ))]), REFUSED),
    "rename a column": (renamed, REFUSED),
    "repeat a column": (lambda t, d: t.select([*t.column_names, one(d, t.column_names)]), REFUSED),
    "extra column": (folders.extra(0.5, "note", None, True, [1.0], b"\xff"), SAME),
    "no numbers": (folders.typed(folders.no_numbers, *VALUES, "rows"), REFUSED),
    "other numbers": (folders.typed(folders.other_numbers, *VALUES), EITHER),
    "no texts": (
        folders.typed(lambda v: [[x] * len(v) for x in (1, None, b"", [""], True)], "failure"),
        REFUSED,
    ),
    "poisoned runs": (folders.cells((np.nan, np.inf, -np.inf, None), *VALUES), REFUSED),
    "huge numbers": (folders.cells((1e300, -1e300, 1e160, 1e20), *VALUES), EITHER),
    "negative errors": (folders.cells((-1.0, -1e-9), "full.se.", "mass_se", "full.sigma"), REFUSED),
    "odd freedoms": (folders.cells((0.0, -1.0, 0.5, 1e300, np.nan, np.inf), "full.dof.", "mass_dof"), EITHER),
    "odd counts": (folders.cells((-1, 2**62, 10**6), "rows", "dropped"), EITHER),
    "poisoned statistics": (folders.cells((np.nan, np.inf, 1e300, -1.0), "full.sigma", "full.chi"), EITHER),
    "other estimates": (folders.whole(BETTER), RIGHT),
    "other errors": (folders.whole(WORSE), RIGHT),
    "a run that failed": (failed("too few postures", "x" * 5_000, *filter(None, documents.HOSTILE)), RIGHT),
    "runs in another order": (lambda t, d: t.take([2, 0, 1]), REFUSED),
    "a run less": (lambda t, d: t.take(sorted(d(folders.st.permutations(range(3)))[1:])), REFUSED),
    "a run more": (lambda t, d: pa.concat_tables([t, t[:1]]), REFUSED),
    "no runs": (lambda t, d: t[:0], REFUSED),
    "other runs": (folders.whole({"run": lambda v: v + 25}), REFUSED),
}

# --- kinds -------------------------------------------------------------------------------------

RUNS = (0, -1, 1, 2, 4, 26, 10**6, 10**13, 10**250, "3", None, True, 2.5)
FIELDS = (None, "x" * 64, "0" * 64, "", "\x1b", 1, [], {})
RUN_KINDS: dict[str, Change] = {
    **documents_of(RUN, RESULT, TRUTH),
    **others(RUN, RESULT, TRUTH),
}
MONTECARLO_KINDS: dict[str, Change] = {
    **documents_of(RUN),
    **others(RUN, CHUNK),
    **{f"{kind} in the runs": runs(*how) for kind, how in TABLE_EDITS.items()},
    "numbers of runs": content(put("settings.runs", *RUNS), refused(WHOLE), RUN),
    "another engine": content(put("settings.engine", "dynamics", "", 1, None), EITHER, RUN),
    "garbage for runs": content(folders.garbage, REFUSED, CHUNK),
    "flipped bytes in the runs": content(changes.flipped, EITHER, CHUNK),
    "truncated runs": content(changes.truncated, REFUSED, CHUNK),
    "report.json made anew": content(edited(documents.strange_value), SAME, REPORT),
    "hash of another plan": content(put("inputs.plan", *FIELDS), refused(WHOLE), RUN),
    "no runs yet": without(refused(WHOLE, "holds 0 of 3 runs"), CHUNK),
    "no plan": without(refused("plan"), "plan/plan.json"),
}
