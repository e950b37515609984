"""Tables of a discovery, from its JSON document."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Any

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import listed
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.discovery.discover import NONE
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.instance import effect_label
from tulip_testbed.experiments.family_tables import SPREAD

BY_CHANCE = 0.05  # probability that noise alone marks any parameter as moved
MOST_P = 0.05  # above it a pattern in the residuals gets no row
HELD_OUT_MM = "heldout_rms_mm"
CHANNEL_NAMES = {
    "A": "A, centre of pressure",
    "F": "F, sum of the vertical forces",
    "T": "T, twist of the plates",
    "C": "C, closure of the legs",
    "all": "all channels",
    HELD_OUT_MM: "centre of pressure, mm r.m.s. per axis",
}


def gap_table(gap: dict[str, Any]) -> Table:
    """Return the residuals by channel before and after, and what chance alone may give."""
    columns = (Column("channel"), *(Column(n, format=".2f") for n in ("before", "after", "by chance up to")))
    rows = [
        [name, *(Cell(gap[channel][key], f"gap.{channel}.{key}") for key in ("before", "after", "floor"))]
        for channel, name in CHANNEL_NAMES.items()
        if gap.get(channel)
    ]
    note = (
        "Before: the nominal model, everything exact. After: ordinary imperfections and the explanations, "
        "estimated from the other placements. In millimetres the last number is the noise."
        if gap.get(HELD_OUT_MM)
        else ""
    )
    return Table("Residuals on held-out placements, as multiples of the noise", columns, rows, note)


def candidate_table(candidates: list[dict[str, Any]]) -> Table:
    """Return the effects that explain a gap, with their sizes and evidence."""
    columns = (
        Column("gap", format="d"),
        Column("effect"),
        Column("size"),
        Column("ln of Bayes factor", format=".1f"),
        Column("behind the best", format=".1f"),
    )
    rows = []
    for k, (candidate, short) in enumerate(zip(candidates, behind(candidates), strict=True)):
        key = f"candidates.{k}"
        rows.append(
            [
                Cell(candidate["gap"], f"{key}.gap"),
                effect_label(candidate["name"], candidate["target"]),
                "; ".join(
                    f"{p['name']} {_size(candidate['name'], candidate['target'], p)}"
                    for p in candidate["parameters"]
                ),
                Cell(candidate["log_bayes_factor"], f"{key}.log_bayes_factor"),
                short,
            ]
        )
    note = "±: half of the 95 % interval. Rows of one gap explain the same part of the residuals."
    return Table("Explanations", columns, rows, note)


def spread_table(families: list[dict[str, Any]]) -> Table:
    """Return the families of ordinary imperfections with their spreads."""
    columns = (
        Column("family"),
        Column("tolerance"),
        Column("spread", "tolerances", ".2f"),
        Column("low", "", ".2f"),
        Column("high", "", ".2f"),
    )
    rows = []
    for k, family in enumerate(families):
        parameter = catalogue()[family["name"]].parameters[0]
        figures = (Cell(family[key], f"families.{k}.{key}") for key in ("spread", "low95", "high95"))
        rows.append([family["name"], parameter.text(family["tolerance"]), *figures])
    return Table("Families of ordinary imperfections", columns, rows, SPREAD)


def calibrated_table(members: list[dict[str, Any]]) -> Table:
    """Return the ordinary imperfections that were added to the model."""
    rows = [
        [
            effect_label(member["name"], member["target"]),
            "; ".join(
                f"{p['name']} {_size(member['name'], member['target'], p)}" for p in member["parameters"]
            ),
        ]
        for member in members
    ]
    columns = (Column("imperfection"), Column("size"))
    return Table("Calibrated", columns, rows, "±: half of the 95 % interval.")


def behind(candidates: list[dict[str, Any]]) -> list[float]:
    """Return by how much ln of the Bayes factor of each falls short of the best of its gap."""
    best: dict[int, float] = {}
    for candidate in candidates:
        gap = candidate["gap"]
        best[gap] = max(best.get(gap, -math.inf), candidate["log_bayes_factor"])
    return [best[candidate["gap"]] - candidate["log_bayes_factor"] for candidate in candidates]


def _size(effect: str, target: str, document: dict[str, Any]) -> str:
    name, unit, value = document["name"], document["unit"], document["value"]
    known = catalogue()[effect].parameters_on(target) if effect in catalogue() else ()
    parameter = next((p for p in known if p.name == name), Parameter(name, unit))
    if parameter.choices and value not in range(len(parameter.choices)):
        parameter = Parameter(name, unit)
    low, high = document["low95"], document["high95"]
    return parameter.text(value, None if low is None or high is None else (low, high))


def moved_table(
    rows: list[dict[str, Any]], effects: Sequence[dict[str, Any]], all_of_them: bool = True
) -> Table:
    """Return the base parameters without and with the correction; one estimate if nothing was corrected.

    Args:
        effects: that were adopted.
        all_of_them: whether those that hardly moved are listed too.
    """
    names = ["number", "name", "before_mm", "after_mm", "standard_error_mm", "moved_in_standard_errors"]
    columns = [
        Column("no.", format="d"),
        Column("parameter"),
        Column("before: no corrections", "mm", ".2f"),
        Column("after: corrected", "mm", ".2f"),
        Column("s.e.", "mm", ".2f"),
        Column("moved by", "s.e.", "+.2f"),
        Column("change"),
    ]
    bound, title = least_move(len(rows)), "Base parameters before and after the correction"
    if not effects:
        names, title = ["number", "name", "before_mm", "standard_error_mm"], "Base parameters"
        columns = [*columns[:2], Column("estimate: no corrections", "mm", ".2f"), columns[4]]
    lines = []
    for k, row in enumerate(rows):
        mark = "moved" if abs(row["moved_in_standard_errors"] or 0.0) > bound else ""
        if mark or all_of_them:
            cells = [Cell(row[name], f"parameters.{k}.{name}", mark) for name in names]
            lines.append([*cells, Cell(mark, mark=mark)] if effects else cells)
    return Table(title, tuple(columns), lines, moved_words(rows, effects))


def least_move(count: int) -> float:
    """Return the move [standard errors] that noise exceeds in any of `count` parameters at most once in 20.

    Bonferroni's bound, which holds however the parameters are correlated.
    """
    return NormalDist().inv_cdf(1 - BY_CHANCE / (2 * max(count, 1)))


def moved_words(rows: list[dict[str, Any]], effects: Sequence[dict[str, Any]]) -> str:
    """Say what was assumed, how many base parameters moved, and what counts as moved."""
    if not effects:
        return (
            "No effect was removed, so there is one estimate of the base parameters: by the self-calibrating "
            "estimator, which estimates ordinary imperfections with them."
        )
    bound = least_move(len(rows))
    moves = {row["name"]: abs(row["moved_in_standard_errors"]) for row in rows}
    count = sum(move > bound for move in moves.values())
    largest = max(moves, key=lambda name: moves[name])
    removed = listed([effect_label(effect["name"], effect["target"]) for effect in effects])
    return (
        f"{count or 'None'} of {len(rows)} parameters moved by more than {bound:.1f} standard errors, which "
        f"noise exceeds in any of them at most once in 20 times; the largest move is "
        f"that of {largest}, {moves[largest]:.1f}. Before: nothing removed from the measurements. After: "
        f"{removed} removed. Both by the self-calibrating estimator, which estimates ordinary imperfections "
        "with the base parameters and takes up a part of the effect before."
    )


def pattern_table(patterns: list[dict[str, Any]]) -> Table:
    """Return the clearest patterns in the residuals after the correction."""
    columns = (Column("channel"), Column("pattern"), Column("p", format=".2g"))
    rows = [
        [Cell(p[name], f"left.{k}.{name}") for name in ("channel", "pattern", "p")]
        for k, p in enumerate(patterns)
        if p["p"] < MOST_P
    ]
    return Table("The clearest patterns in the remaining residuals", columns, rows)


def repeat_table(repeats: dict[str, Any]) -> Table:
    """Return how repeated postures agree with the stated noise."""
    columns = (
        Column("channel"),
        Column("chi² per degree of freedom", format=".2f"),
        Column("p", format=".2g"),
    )
    rows = [
        [
            CHANNEL_NAMES.get(channel, channel),
            Cell(ratio, f"repeats.chi_square_per_freedom.{channel}"),
            Cell(repeats["p"].get(channel), f"repeats.p.{channel}"),
        ]
        for channel, ratio in repeats["chi_square_per_freedom"].items()
    ]
    return Table("Repeated postures against the stated noise", columns, rows)


def undetectable_table(entries: list[dict[str, Any]]) -> Table:
    """Return the effects that these postures cannot detect, one per row."""
    columns = (
        Column("effect"),
        Column("targets"),
        Column("biases most the parameter no.", format="d"),
        Column("by, per prior s.d.", "mm", ".2f"),
    )
    by_name: dict[str, list[dict[str, Any]]] = {}
    for entry in entries:
        by_name.setdefault(entry["name"], []).append(entry)
    rows = []
    for name, of in by_name.items():
        worst = max(of, key=lambda entry: entry["bias_mm_per_prior_sd"] or 0.0)
        predicted = worst["parameter"] is not None
        rows.append(
            [
                name,
                [entry["target"] for entry in of if entry["target"]],
                worst["parameter"] if predicted else "not predicted",
                worst["bias_mm_per_prior_sd"] if predicted else None,
            ]
        )
    return Table("Effects that these postures cannot detect", columns, rows)


def weak_table(entries: list[dict[str, Any]]) -> Table:
    """Return the effects that show only if larger than plausible, one kind per row.

    Args:
        entries: of `WeaklyDetectable`, as a report has them.
    """
    columns = (
        Column("effect"),
        Column("targets"),
        Column("shows from (90 %)"),
        Column("over the plausible size"),
    )
    by_unit: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for entry in sorted(entries, key=lambda entry: entry["least_over_prior"]):
        by_unit.setdefault((entry["name"], _first_size(entry).unit), []).append(entry)
    rows = []
    for (name, _), of in by_unit.items():
        ends = of[0], of[-1]
        sizes = [_first_size(entry).text(entry["least"]) for entry in ends if entry["least"] is not None]
        multiples = [number(entry["least_over_prior"], ".2g") for entry in ends]
        targets = [entry["target"] for entry in of if entry["target"]]
        rows.append([name, targets, _from_to(sizes) if sizes else "several numbers", _from_to(multiples)])
    return Table("Effects that show only if larger than plausible", columns, rows)


def _first_size(entry: dict[str, Any]) -> Parameter:
    effect = catalogue()[entry["name"]]
    return effect.parameters_on(entry["target"] or "")[effect.sizes[0]]


def _from_to(ends: list[str]) -> str:
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def dynamics_line(check: dict[str, Any]) -> str:
    """Describe how the adopted effects compare with a simulation in full dynamics."""
    if check["reason"] is not None:
        return f"In full dynamics nothing could be compared: {check['reason']}."
    return (
        f"In full dynamics {check['postures']} of {check['tried']} postures stood; the residual after "
        f"removing the adopted effects is {check['left_over_noise']:.2f} times the noise."
    )


def discovery_summary(document: dict[str, Any], story: Sequence[str]) -> list[Table | str]:
    """Return the tables and sentences of a discovery in short.

    Args:
        document: its report as JSON. story: the finding in sentences.
    """
    parts: list[Table | str] = [*story, ""]
    if document["verdict"] == NONE and (weak := weak_table(document.get("weakly_detectable", []))).rows:
        parts.append(weak)
    if any(entry and entry["after"] is not None for entry in document["gap"].values()):
        parts.append(gap_table(document["gap"]))
    if document["candidates"]:
        parts.append(candidate_table(document["candidates"]))
    if document["families"]:
        parts.append(spread_table(document["families"]))
    if rows := document["parameters"]:
        moved = moved_table(rows, document["effects"], all_of_them=False)
        parts.append(moved if moved.rows else moved_words(rows, document["effects"]))
    if document["check"]:
        parts.append(dynamics_line(document["check"]))
    return parts
