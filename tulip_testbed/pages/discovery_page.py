"""The page of a discovery: the findings, the residuals before and after, and the evidence."""

from __future__ import annotations

from typing import Any

import numpy as np

from tulip_testbed.experiments.discovery_record import DiscoveryRecord
from tulip_testbed.experiments.discovery_tables import (
    CHANNEL_NAMES,
    HELD_OUT_MM,
    MOST_P,
    calibrated_table,
    candidate_table,
    dynamics_line,
    gap_table,
    moved_table,
    pattern_table,
    repeat_table,
    spread_table,
    undetectable_table,
    weak_table,
)
from tulip_testbed.experiments.law_curves import law_curves
from tulip_testbed.experiments.proposed_experiment import experiment_table
from tulip_testbed.experiments.residual_curves import Curve, residual_curves, time_order
from tulip_testbed.experiments.rig_folder import DIFF
from tulip_testbed.pages import discovery_figures as drawn
from tulip_testbed.pages.figures import Figure
from tulip_testbed.pages.page import Page, Section, how_it_was_made, title_of
from tulip_testbed.pages.words import EVIDENCE_WORDS, GAP_WORDS, ORDINARY_WORDS, VERDICTS


def discovery_page(run: DiscoveryRecord) -> Page:
    """Make the page of a discovery."""
    report, content = run.report, run.report.plain()
    curves = residual_curves(run)
    changed = bool(report.candidates or report.calibrated)
    sections = [
        Section(
            "The gap",
            GAP_WORDS,
            (gap_table(content["gap"]),),
            (*_gap_figures(content["gap"]), *_planes(curves, changed)),
        ),
        *_laws(run),
        *_evidence(content),
        *_ordinary(content),
        Section(
            "Residuals over the experiment",
            (
                "Vermilion: as measured. Blue: with the found effects removed. Band: 95 % of the noise. The "
                "swing foot's x, y and yaw are shown about their mean in a stance: angles give no more.",
            ),
            figures=_curves(run, curves, changed),
        ),
        *_parameters(content),
        *_next(content),
        *_doubts(content),
        *_check(content["check"]),
    ]
    if DIFF in run.rig:
        words = "Changes by the adopted rig. Its folder is for --corrections of other commands."
        sections.append(Section("The adopted rig", (words,), folded=(("Differences", run.rig[DIFF]),)))
    sections.append(how_it_was_made(run))
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


def _gap_figures(gap: dict[str, Any]) -> tuple[Figure, ...]:
    rows = [
        (CHANNEL_NAMES[channel], entry["before"], entry["after"], entry["floor"])
        for channel, entry in gap.items()
        if channel != HELD_OUT_MM and entry and entry["after"] is not None
    ]
    return (drawn.gap_figure(rows),) if rows else ()


def _planes(curves: list[Curve], changed: bool) -> tuple[Figure, ...]:
    """Draw the centre of pressure before and after side by side, at one scale."""
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


def _laws(run: DiscoveryRecord) -> tuple[Section, ...]:
    """Return the section of the adopted laws, each with its curve."""
    if not run.report.laws:
        return ()
    words = [law.sentence for law in run.report.laws]
    words += [
        f"As good: {other.what} as a function of {other.of} ({other.shape})."
        for law in run.report.laws
        for other in law.also
    ]
    figures = tuple(drawn.law_figure(k, curve) for k, curve in enumerate(law_curves(run)))
    return (Section("The law", tuple(words), figures=figures),)


def _evidence(report: dict[str, Any]) -> tuple[Section, ...]:
    found = report["candidates"]
    if not found:
        return ()
    words = (EVIDENCE_WORDS[report["verdict"] == "unknown"],)
    drawing = drawn.evidence_figure(found, report["runners_up"])
    return (Section("Evidence", words, (candidate_table(found),), (drawing,)),)


def _ordinary(report: dict[str, Any]) -> tuple[Section, ...]:
    """Return the section of the families of ordinary imperfections and of the members added to the model."""
    tables = [spread_table(report["families"]), calibrated_table(report["calibrated"])]
    shown = tuple(table for table in tables if table.rows)
    return (Section("Ordinary imperfections", (ORDINARY_WORDS,), shown),) if shown else ()


def _parameters(report: dict[str, Any]) -> tuple[Section, ...]:
    rows = report["parameters"]
    return (Section("Base parameters", tables=(moved_table(rows, report["effects"]),)),) if rows else ()


def _next(report: dict[str, Any]) -> tuple[Section, ...]:
    ranking = report["next_experiment"]
    table = experiment_table(ranking, "next_experiment")
    return (Section("Next experiment", tables=(table,)),) if ranking else ()


def _doubts(report: dict[str, Any]) -> tuple[Section, ...]:
    """Return the section of remaining patterns, repeats and effects that the postures cannot detect."""
    tables = [
        pattern_table(report["left"]),
        repeat_table(report["repeats"]),
        undetectable_table(report["undetectable"]),
        weak_table(report.get("weakly_detectable", [])),
    ]
    words = tuple(f"Noise not as stated: {text}." for text in report["noise"]["not_as_stated"])
    if not tables[0].rows:
        words += (f"The remaining residuals have no pattern (p above {MOST_P} for all that were tried).",)
    return (Section("Limits of the finding", words, tuple(table for table in tables if table.rows)),)


def _check(check: dict[str, Any] | None) -> tuple[Section, ...]:
    return (Section("In full dynamics", (dynamics_line(check),)),) if check else ()
