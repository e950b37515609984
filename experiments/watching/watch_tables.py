"""Tables of the last postures and of the standard errors in a watch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from tulip_testbed.base.column import Column
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.watching.watch_day import EVERY, Arrival
from tulip_testbed.experiments.watching.watch_row import CHANGED, OK, Verdict
from tulip_testbed.identification.residual_channels import CHANNELS

LATEST = 12  # rows that are shown


def watch_table(arrivals: Sequence[Arrival], targets: Mapping[str, float] | None) -> Table:
    """Return the last postures and what to do now.

    Args:
        arrivals: in their order. targets: see `WatchSettings`.
    """
    columns = (
        Column("posture", format="d"),
        Column("verdict"),
        *(Column(channel, format=".1f") for channel in CHANNELS),
        Column("found"),
    )
    rows = []
    for one in arrivals[-LATEST:]:
        if one.verdict is None:
            rows.append([None, Cell("unreadable", mark="fail"), *[math.nan] * len(CHANNELS), one.problem])
            continue
        v = one.verdict
        mark = "pass" if v.verdict == OK else "fail" if v.verdict == CHANGED else "warn"
        misfit = [v.misfit[channel] for channel in CHANNELS]
        rows.append([v.posture, Cell(v.verdict, mark=mark), *misfit, said(v)])
    last = next((one.verdict for one in reversed(arrivals) if one.verdict is not None), None)
    note = "" if last is None else " ".join(advice(last, targets))
    return Table("Last postures; misfit by channel in standard deviations", columns, rows, note)


def said(verdict: Verdict) -> str:
    """Return the findings as one text."""
    return "; ".join(f"{one.name}: {one.seen}" for one in verdict.findings)


def line(verdict: Verdict) -> str:
    """Return a posture as one line of text."""
    found = f" - {said(verdict)}" if verdict.findings else ""
    then = "" if verdict.next is None else f"; next {verdict.next}"
    return f"posture {verdict.posture}: {verdict.verdict}{found}{then}"


def advice(verdict: Verdict, targets: Mapping[str, float] | None) -> list[str]:
    """Return what to do now, and how the standard errors stand, as sentences."""
    told = []
    if verdict.stop:
        told.append(f"Stop: {verdict.stop}.")
    if verdict.onset is not None:
        told.append(f"Something changed at posture {verdict.onset}: correct it and measure from there again.")
    if verdict.next is not None:
        again = " again" if verdict.next == verdict.posture else ""
        told.append(f"Next: posture {verdict.next}{again}; {verdict.left} left.")
    name, worst = max(verdict.standard_errors.items(), key=lambda each: each[1])
    if math.isfinite(worst):
        told.append(f"Largest standard error: {number(1e3 * worst, '.2f')} mm ({name}).")
    else:
        told.append("The postures do not determine all base parameters yet.")
    if targets:
        open_targets = [name for name, error, target in _errors(verdict, targets) if error > target]
        told.append(f"Targets that are not met: {len(open_targets)} of {len(verdict.standard_errors)}.")
    return told


def error_table(verdict: Verdict, targets: Mapping[str, float] | None) -> Table:
    """Return the standard errors with their targets."""
    columns = (
        Column("no.", format="d"),
        Column("parameter"),
        Column("s.e.", "mm", ".2f"),
        Column("target", "mm", ".2f"),
        Column("met"),
    )
    rows = []
    for k, (name, error, target) in enumerate(_errors(verdict, targets or {}), 1):
        wanted = math.isfinite(target)
        met = Cell("yes", mark="pass") if error <= target else Cell("no", mark="warn")
        rows.append([k, name, 1e3 * error, 1e3 * target if wanted else None, met if wanted else ""])
    note = "By the data sheets and the postures so far; the readings' scatter does not enter."
    return Table("Standard errors of the base parameters", columns, rows, note)


def _errors(verdict: Verdict, targets: Mapping[str, float]) -> list[tuple[str, float, float]]:
    """Return name, standard error and target of every base parameter [m]."""
    every = targets.get(EVERY, math.inf)
    return [(name, error, targets.get(name, every)) for name, error in verdict.standard_errors.items()]
