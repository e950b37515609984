"""A discovery's page: what was found, before and after, and what it rests on."""

from __future__ import annotations

from typing import Any

import numpy as np

from tulip_testbed.effects.instance import ParameterDocument
from tulip_testbed.experiments.discovery_record import DiscoveryRecord
from tulip_testbed.experiments.discovery_report import Check, DiscoveryReport
from tulip_testbed.experiments.residual_curves import Curve, residual_curves, time_order
from tulip_testbed.experiments.rig_folder import DIFF
from tulip_testbed.pages import discovery_figures as drawn
from tulip_testbed.pages.figures import Figure
from tulip_testbed.pages.page import Page, Section, title_of
from tulip_testbed.pages.page_tables import Cell, Table, number, settings_table
from tulip_testbed.pages.words import (
    CHANNEL_NAMES,
    EVIDENCE_WORDS,
    GAP_WORDS,
    VERDICTS,
    behind,
)

SHOWN_P = 0.05  # above it a pattern of what is left is not worth a row
MOVED = 0.5  # standard errors from which on a parameter's change is marked


def discovery_page(run: DiscoveryRecord) -> Page:
    """Make the page of a discovery."""
    report, content = run.report, run.report.plain()
    curves = residual_curves(run)
    changed = bool(report.candidates)
    sections = [
        Section(
            "The gap",
            GAP_WORDS,
            (gap_table(content["gap"]),),
            (*_gap_figures(report), *_planes(curves, changed)),
        ),
        *_evidence(report),
        Section(
            "Residuals over the experiment",
            (
                "Vermilion: as measured. Blue: freed of what was found. Band: 95 % of the noise. The swing "
                "foot's x, y and yaw are shown about their mean in a stance: angles do not tell more.",
            ),
            figures=_curves(run, curves, changed),
        ),
        *_parameters(content),
        *_next(content),
        *_doubts(content),
        *_check(report.check),
    ]
    if run.rig:
        words = "What the adopted rig changes; its folder serves --rig of simulate, identify and validate."
        sections.append(Section("The adopted rig", (words,), folded=(("Differences", run.rig[DIFF]),)))
    sections.append(Section("How it was made", tables=(settings_table(run.document.plain()),)))
    measured = run.measurements
    facts = (
        ("measurements", run.document.configuration.measurements),
        ("postures", str(len(np.unique(measured.posture)))),
        ("readings", str(len(measured))),
        ("placements", str(len(np.unique(measured.placement)))),
        ("repeated pairs", str(report.repeats.pairs)),
        ("search, s", f"{report.wall_s:.1f}"),
    )
    sentence, *story = report.story
    sentence = f"{VERDICTS[report.verdict]} {sentence}"
    return Page(title_of(run), report.verdict, sentence, facts, tuple(sections), story=tuple(story))


def gap_table(gap: dict[str, Any]) -> Table:
    """By channel before and after, and what it may be by chance."""
    rows = []
    for channel, name in CHANNEL_NAMES.items():
        if entry := gap.get(channel):
            unit = " [mm, r.m.s. per axis; last: the noise]" if channel == "heldout_rms_mm" else ""
            figures = (
                number(f"gap.{channel}.{key}", entry[key], ".2f") for key in ("before", "after", "floor")
            )
            rows.append([Cell(name + unit), *figures])
    return Table("The gap before and after", ("channel", "before", "after", "by chance up to"), rows)


def _gap_figures(report: DiscoveryReport) -> tuple[Figure, ...]:
    rows = [
        (CHANNEL_NAMES[channel], ratio.before, ratio.after, ratio.floor)
        for channel, ratio in report.gap.items()
        if channel != "heldout_rms_mm" and ratio is not None and ratio.after is not None
    ]
    return (drawn.gap_figure(rows),) if rows else ()


def _planes(curves: list[Curve], changed: bool) -> tuple[Figure, ...]:
    """The centre of pressure before and after side by side, at one scale."""
    x, y = curves[:2]
    sides = {"before": (x.before, y.before)} | ({"after": (x.after, y.after)} if changed else {})
    reach = 1.1 * max(float(np.abs(values).max()) for side in sides.values() for values in side)
    sd = float(np.sqrt((np.mean(x.sd**2) + np.mean(y.sd**2)) / 2))
    return tuple(drawn.plane_figure(name, *side, sd, reach) for name, side in sides.items())


def _curves(run: DiscoveryRecord, curves: list[Curve], changed: bool) -> tuple[Figure, ...]:
    posture = run.measurements.posture[time_order(run)]
    return tuple(
        drawn.curve_figure(k, curve, posture, changed)
        for k, curve in enumerate(curves)
        if np.isfinite(curve.sd).any()
    )


def _evidence(report: DiscoveryReport) -> tuple[Section, ...]:
    found = report.candidates
    if not found:
        return ()
    rows = []
    for k, (one, short) in enumerate(zip(found, behind(found), strict=True)):
        key = f"candidates.{k}"
        rows.append(
            [
                number(f"{key}.gap", one.gap, ".0f"),
                Cell(one.label),
                Cell("; ".join(_value(p) for p in one.parameters)),
                number(f"{key}.log_bayes_factor", one.log_bayes_factor, ".1f"),
                Cell(f"{short:.1f}", style="number"),
            ]
        )
    headers = ("gap", "explanation", "size [95 % interval]", "ln BF", "behind the best")
    words = (EVIDENCE_WORDS[report.verdict == "unknown"],)
    table = Table("Explanations", headers, rows)
    return (Section("Evidence", words, (table,), (drawn.evidence_figure(found),)),)


def _value(parameter: ParameterDocument) -> str:
    text = f"{parameter.name} {parameter.value:.4g} {parameter.unit}".strip()
    low, high = parameter.low95, parameter.high95
    return text if low is None or high is None else f"{text} [{low:.4g}, {high:.4g}]"


def _parameters(report: dict[str, Any]) -> tuple[Section, ...]:
    rows = []
    for k, row in enumerate(report["parameters"]):
        key, moved = f"parameters.{k}", row["moved_in_standard_errors"]
        rows.append(
            [
                number(f"{key}.number", row["number"], ".0f"),
                Cell(row["name"], f"{key}.name", row["name"]),
                number(f"{key}.before_mm", row["before_mm"], ".2f"),
                number(f"{key}.after_mm", row["after_mm"], ".2f"),
                number(f"{key}.standard_error_mm", row["standard_error_mm"], ".2f"),
                number(f"{key}.moved_in_standard_errors", moved, "+.2f"),
                Cell("moved" if abs(moved) > MOVED else ""),
            ]
        )
    if not rows:
        return ()
    headers = ("nr", "parameter", "before", "after", "s.e.", "moved by [s.e.]", "")
    note = "After: identified from measurements freed of what was adopted. Nothing adopted: nothing moves."
    return (Section("Base parameters", tables=(Table("Base parameters, mm", headers, rows, note),)),)


def _next(report: dict[str, Any]) -> tuple[Section, ...]:
    rows = [
        [
            Cell(entry["do"], f"next_experiment.{k}.do", entry["do"]),
            number(f"next_experiment.{k}.separation_gain", entry["separation_gain"], ".3g"),
        ]
        for k, entry in enumerate(report["next_experiment"])
    ]
    table = Table("What would tell them apart", ("do", "separation, times that of now"), rows)
    return (Section("Next experiment", tables=(table,)),) if rows else ()


def _doubts(report: dict[str, Any]) -> tuple[Section, ...]:
    """What is left, what repeats say of the noise, what these postures cannot show."""
    left = [
        [
            Cell(entry["channel"], f"left.{k}.channel", entry["channel"]),
            Cell(entry["pattern"], f"left.{k}.pattern", entry["pattern"]),
            number(f"left.{k}.p", entry["p"], ".2g"),
        ]
        for k, entry in enumerate(report["left"])
        if entry["p"] < SHOWN_P
    ]
    repeats = report["repeats"]
    noise = [
        [
            Cell(CHANNEL_NAMES[channel]),
            number(f"repeats.chi_square_per_freedom.{channel}", ratio, ".2f"),
            number(f"repeats.p.{channel}", repeats["p"][channel], ".2g"),
        ]
        for channel, ratio in repeats["chi_square_per_freedom"].items()
    ]
    tables = []
    if left:
        tables.append(Table("The clearest patterns in what is left", ("channel", "pattern", "p"), left))
    if noise:
        headers = ("channel", "chi² per degree of freedom", "p")
        tables.append(Table("Repeated postures against the stated noise", headers, noise))
    if report["undetectable"]:
        tables.append(_hidden(report["undetectable"]))
    words = tuple(f"Noise not as stated: {text}." for text in report["noise"]["not_as_stated"])
    if not left:
        words += (f"What is left has no pattern (p above {SHOWN_P} for all that were tried).",)
    return (Section("What to doubt", words, tuple(tables)),)


def _hidden(entries: list[dict[str, Any]]) -> Table:
    """What leaves no residual, an effect a row."""
    by_name: dict[str, list[dict[str, Any]]] = {}
    for entry in entries:
        by_name.setdefault(entry["name"], []).append(entry)
    rows = []
    for name, of in by_name.items():
        worst = max(of, key=lambda entry: entry["bias_mm_per_prior_sd"] or 0.0)
        cells = ("not predicted", "")
        if worst["bias_mm_per_prior_sd"] is not None:
            cells = (str(worst["parameter"]), f"{worst['bias_mm_per_prior_sd']:.2f}")
        targets = ", ".join(entry["target"] for entry in of if entry["target"])
        rows.append([Cell(name), Cell(targets), *(Cell(cell, style="number") for cell in cells)])
    headers = ("effect", "targets", "biases parameter most", "by, mm per prior s.d.")
    return Table("What these postures cannot show", headers, rows)


def _check(check: Check | None) -> tuple[Section, ...]:
    if check is None:
        return ()
    if check.left_over_noise is None:
        return (Section("In full dynamics", (f"Nothing could be compared: {check.reason}.",)),)
    words = (
        f"The adopted model was simulated in full dynamics: {check.postures} of {check.tried} postures "
        f"stood. What the adopted effects leave there is {check.left_over_noise:.2f} times the noise."
    )
    return (Section("In full dynamics", (words,)),)
