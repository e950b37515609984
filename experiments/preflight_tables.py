"""The report of a preflight: what was found, what to do about it, what an incomplete folder lacks."""

from __future__ import annotations

from typing import Any

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.example import compact_json
from tulip_testbed.measurements.measurement_folder import MAY_LACK

NOT_EVALUATED = "not evaluated"


def finding_table(checks: list[dict[str, Any]]) -> Table:
    """Return every check of a preflight with what was found and what is expected."""
    columns = (Column("check"), Column("result"), Column("found"), Column("expected"))
    rows = [[c["name"], Cell(c["result"], mark=c["result"]), c["seen"], c["expected"]] for c in checks]
    return Table("Preflight", columns, rows)


def advice_table(checks: list[dict[str, Any]]) -> Table:
    """Return where the checks that warn or fail see the fault, and what to do about it."""
    columns = (Column("check"), Column("result"), Column("where"), Column("what to do"))
    rows = [
        [c["name"], Cell(c["result"], mark=c["result"]), c["where"], c["advice"]]
        for c in checks
        if c["result"] in ("warn", "fail")
    ]
    return Table("Advice", columns, rows)


def complaint_lines(document: dict[str, Any]) -> list[str]:
    """Return what an incomplete folder lacks, with an example to copy."""
    about, within = (document["complaints"][key] for key in ("manifest", "table"))
    lines = ["This folder cannot be read yet:", *(f"  - {text}" for text in (*about, *within))]
    if about:
        lines += [
            "",
            "An example manifest.json for this robot; replace every null that you know:",
            *compact_json(document["example_manifest"]).splitlines(),
        ]
    if within:
        row = document["example_row"]
        lines += [
            "",
            "An example postures.csv with one posture, all joints at zero (rad, N, m):",
            ",".join(row),
            ",".join(f"{value:g}" for value in row.values()),
            "",
            f"These columns are optional: {', '.join(MAY_LACK)}.",
        ]
    return [*lines, "", "docs/how-to/your-data.md explains the format step by step."]


def preflight_report(document: dict[str, Any]) -> list[Table | str]:
    """Return the tables and sentences of a preflight of measurements that could be read."""
    parts: list[Table | str] = [finding_table(document["checks"])]
    if (advice := advice_table(document["checks"])).rows:
        parts.append(advice)
    skipped = [check["seen"] for check in document["checks"] if check["result"] == NOT_EVALUATED]
    if skipped:
        reasons = [f"{skipped.count(reason)} ({reason})" for reason in dict.fromkeys(skipped)]
        parts.append(f"Not evaluated: {'; '.join(reasons)}.")
    return [*parts, "{rows} rows of {postures} postures on {placements} placements.".format_map(document)]


def counts_line(document: dict[str, Any]) -> str:
    """Return how many checks were evaluated, and how many of them had which result."""
    counts = {result: count for result, count in document["counts"].items() if count}
    every = sum(counts.values())
    evaluated = every - counts.pop(NOT_EVALUATED, 0)
    results = ", ".join(f"{count} {result}" for result, count in counts.items())
    return f"{evaluated} of {every} checks evaluated: {results}"
