"""The report of a preflight: what was found, what to do about it, what an incomplete folder lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Cell, Table, Verbatim
from tulip_testbed.experiments.example import compact_json
from tulip_testbed.identification.preflight import Finding
from tulip_testbed.measurements.measurement_folder import MAY_LACK

NOT_EVALUATED = "not evaluated"


def finding_table(checks: Sequence[Finding]) -> Table:
    """Return every check of a preflight with what was found and what is expected."""
    columns = (Column("check"), Column("result"), Column("found"), Column("expected"))
    rows = [[c.name, Cell(c.result, mark=c.result), c.seen, c.expected] for c in checks]
    return Table("Preflight", columns, rows)


def advice_table(checks: Sequence[Finding]) -> Table:
    """Return where the checks that warn or fail see the fault, and what to do about it."""
    columns = (Column("check"), Column("result"), Column("where"), Column("what to do"))
    rows = [
        [c.name, Cell(c.result, mark=c.result), c.where, c.advice]
        for c in checks
        if c.result in ("warn", "fail")
    ]
    return Table("Advice", columns, rows)


def skipped_lines(checks: Sequence[Finding]) -> list[str]:
    """Return how many checks were not evaluated, and why."""
    skipped = [check.seen for check in checks if check.result == NOT_EVALUATED]
    reasons = [f"{skipped.count(reason)} ({reason})" for reason in dict.fromkeys(skipped)]
    return [f"Not evaluated: {'; '.join(reasons)}."] if skipped else []


def complaint_lines(
    about: Sequence[str], within: Sequence[str], manifest: Mapping[str, Any], row: Mapping[str, float]
) -> list[str]:
    """Return what an incomplete folder lacks, with an example to copy.

    Args:
        about, within: complaints about the manifest and the table. manifest, row: examples.
    """
    lines = ["This folder cannot be read yet:", *(f"  - {text}" for text in (*about, *within))]
    if about:
        lines += [
            "",
            "An example manifest.json for this robot; replace every null that you know:",
            *compact_json(dict(manifest)).splitlines(),
        ]
    if within:
        lines += [
            "",
            "An example postures.csv with one posture, all joints at zero (rad, N, m):",
            ",".join(row),
            ",".join(f"{value:g}" for value in row.values()),
            "",
            f"These columns are optional: {', '.join(MAY_LACK)}.",
        ]
    return [
        Verbatim(line) for line in [*lines, "", "docs/how-to/your-data.md explains the format step by step."]
    ]


def counts_line(counts: Mapping[str, int]) -> str:
    """Return how many checks were evaluated, and how many of them had which result."""
    some = {result: count for result, count in counts.items() if count}
    every = sum(some.values())
    evaluated = every - some.pop(NOT_EVALUATED, 0)
    results = ", ".join(f"{count} {result}" for result, count in some.items())
    return f"{evaluated} of {every} checks evaluated: {results}"
