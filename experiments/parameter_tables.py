"""What a person reads in the terminal."""

from __future__ import annotations

import csv
import io
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tulip_testbed.experiments.checks import Check
from tulip_testbed.experiments.correlation_table import meaning, print_correlations
from tulip_testbed.experiments.terminal import print_table
from tulip_testbed.experiments.validate import Validation
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.estimators import Estimate, StandardEstimate
from tulip_testbed.identification.rank import described, labels, weakly_known
from tulip_testbed.identification.statistics import WELL_IDENTIFIED
from tulip_testbed.sim.dynamics.dynamic_run import Experiment
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.files import read_text
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.statics.static_run import StaticRun

LEGEND = (
    "s.e.: by the estimator (least squares: eq. 14); clustered: errors common to a placement allowed for; "
    "rel. %: s.e. over estimate (eq. 13); well id.: that is below 15 %."
)
MOST_TABLE = 2**20  # bytes
NO_PLACEMENT_SD = 1e-3  # of sigma
COLOURS = {"pass": "green", "fail": "bold red", "not evaluated": "yellow"}


PAPER_COLUMNS = tuple(
    f"{model}_{what}" for model in ("full", "simplified") for what in ("mm", "rel_se_percent")
)


def paper_table(robot: Robot) -> dict[int, dict[str, str]]:
    """Table II by parameter number; empty where the robot has none.

    Raises:
        InputError: the file lies outside of the robot's folder or is no such table.
    """
    name = robot.settings.get("paper", {}).get("table")
    if name is None:
        return {}
    path = robot.folder / name
    if "\0" in name or not Path(os.path.realpath(path)).is_relative_to(robot.folder):
        raise InputError(
            f"{robot.path}: key 'paper.table': found '{name}', expected a file in {robot.folder}"
        )
    rows = csv.DictReader(io.StringIO(read_text(path, MOST_TABLE)))
    table: dict[int, dict[str, str]] = {}
    try:
        for row in rows:
            table[int(row["number"])] = values = {column: row[column] for column in PAPER_COLUMNS}
            whole = None not in row and None not in row.values()
            if not whole or not all(math.isfinite(float(text)) for text in values.values() if text):
                raise ValueError
    except (KeyError, TypeError, ValueError, csv.Error):
        expected = f"numbers in the columns number, {', '.join(PAPER_COLUMNS)}"
        raise InputError(f"{path}: line {rows.line_num}: not a table of {expected}") from None
    return table


def models(robot: Robot) -> tuple[str, ...]:
    """The models that are worth a table: without a simplified one the second would be the first."""
    return ("full", "simplified") if "simplified" in robot.settings else ("full",)


def parameter_table(
    title: str,
    document: dict[str, Any],
    parameters: BaseParameters,
    paper: dict[int, dict[str, str]],
    column: str,
) -> Table:
    """A model's parameters, beside those of the paper where given.

    Args:
        paper: `paper_table`, or {}. column: of it, "full" or "simplified".
    """
    known = document["parameters"][0]["truth"] is not None
    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("nr", justify="right")
    table.add_column("parameter", min_width=16)
    headers = ["truth", "estimate", "error"] if known else ["estimate"]
    beside = ["paper %", "paper s.e.", "ratio"] if paper else []
    # The default's own standard errors allow for placements: then the second column would repeat the first.
    apart = any(row["clustered_standard_error"] != row["standard_error"] for row in document["parameters"])
    for header in [*headers, "s.e.", *(["clustered"] if apart else []), "rel. %", *beside]:
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("well id.", no_wrap=True)
    for row in document["parameters"]:
        number = row["number"]
        reported = paper.get(number, {})
        relative = reported.get(f"{column}_rel_se_percent") or ""
        paper_se = abs(float(reported[f"{column}_mm"])) * float(relative) / 100 if relative else None
        estimate, truth = 1e3 * row["estimate"], row["truth"]
        values = [f"{estimate:.2f}"]
        if known:
            values = [f"{1e3 * truth:.2f}", *values, f"{estimate - 1e3 * truth:+.2f}"]
        well = row["relative_standard_error"] < WELL_IDENTIFIED
        theirs = [
            relative,
            "" if paper_se is None else f"{paper_se:.2f}",
            "" if paper_se is None else f"{1e3 * row['standard_error'] / paper_se:.2f}",
        ]
        table.add_row(
            str(number),
            escape(meaning(parameters, number)),
            *values,
            f"{1e3 * row['standard_error']:.2f}",
            *([f"{1e3 * row['clustered_standard_error']:.2f}"] if apart else []),
            f"{row['relative_standard_error']:.1f}" if row["relative_standard_error"] < 1e4 else ">10000",
            *(theirs if paper else []),
            "[green]yes[/]" if well else "no",
        )
    return table


def standard_table(standard: StandardEstimate) -> Table:
    """Link masses and centres of mass with their standard errors and how much of each came from the data."""
    table = Table(
        title="Links, kg and mm (data: share of the information that the measurements gave)",
        title_justify="left",
        header_style="bold",
    )
    table.add_column("link", no_wrap=True)
    for header in ("mass", "s.e.", "data %", "x", "s.e.", "%", "y", "s.e.", "%", "z", "s.e.", "%"):
        table.add_column(header, justify="right", no_wrap=True)
    for k, link in enumerate(standard.links):
        row = [
            f"{standard.mass[k]:.3f}",
            f"{standard.mass_error[k]:.3f}",
            f"{100 * standard.mass_share[k]:.0f}",
        ]
        for axis in range(3):
            row += [f"{1e3 * standard.center[k, axis]:.1f}", f"{1e3 * standard.center_error[k, axis]:.1f}"]
            row.append(f"{100 * standard.center_share[k, axis]:.0f}")
        table.add_row(escape(link), *row)
    return table


def check_table(checks: tuple[Check, ...]) -> Table:
    table = Table(title="Verdict", title_justify="left", header_style="bold")
    for header in ("check", "result", "value", "threshold", "where it comes from"):
        table.add_column(header, justify="right" if header == "value" else "left")
    for check in checks:
        threshold = check.threshold
        text = (
            ""
            if threshold is None
            else f"{threshold[0]:.4g} to {threshold[1]:.4g}"
            if isinstance(threshold, list)
            else f"at most {threshold:.4g}"
        )
        value = "" if check.value is None else f"{check.value:.4g}"
        table.add_row(check.name, f"[{COLOURS[check.result]}]{check.result}[/]", value, text, check.source)
    return table


def weak_directions(estimate: Estimate, parameters: BaseParameters) -> str:
    """Which parameters these postures hardly tell apart: an error longer than the longest link says nothing.

    Returns:
        "" where there are none.
    """
    longest = float(np.abs(parameters.from_standard[:, ::4]).max())
    weak = weakly_known(estimate.clustered_covariance, longest)
    if not len(weak):
        return ""
    text = described(weak, labels(estimate.numbers, estimate.names))
    return f"to within the longest link ({1e3 * longest:.0f} mm) {text}"


def placements_line(document: dict[str, Any]) -> str:
    """What the placements' shared errors are estimated to be, and what they do to the standard errors."""
    right, left = document["placement_sd_mm"]
    if max(right, left) < NO_PLACEMENT_SD * document["sigma_mm"]:
        return (
            "No error common to a placement's postures could be told from the rest (estimated s.d. 0), "
            "so 'clustered' equals s.e. here; few placements often look like that."
        )
    return f"Errors common to a placement: s.d. {right:.2f} mm of the right plate, {left:.2f} mm of the left."


def sag_line(experiment: Experiment) -> str:
    sag = 1e3 * np.abs([held.joint_angles - held.commanded for held in experiment.held])
    torque = np.abs([held.torques for held in experiment.held]).max()
    return (
        f"Joints behind what the servos were sent to: median {np.median(sag):.1f} mrad, "
        f"largest {sag.max():.1f} mrad; "
        f"largest torque {torque:.1f} Nm."
    )


def books_line(books: dict[str, float]) -> str:
    return (
        f"Largest imbalance in any hold: cells against weight {books['weight']:.1e} N, "
        f"plates' moments against the feet's wrench {books['moments']:.1e} Nm, "
        f"torques against statics {books['torques']:.1e} Nm, "
        f"CoP against CoM {1e3 * books['centre']:.1e} mm, "
        f"energy left in motion {books['kinetic']:.1e} J."
    )


def residual_line(document: dict[str, Any], beside: str = "") -> str:
    norms, condition = document["residual_mm"], document["condition_number"]
    return (
        f"Residual norm: mean {norms['mean']:.2f}, s.d. {norms['sd']:.2f}, max {norms['max']:.2f} mm"
        f"{beside}; sigma per axis {document['sigma_mm']:.3f} mm; condition number {condition:.0f}"
    )


def print_validation(console: Console, result: Validation, document: dict[str, Any]) -> None:
    """The whole report."""
    found, robot = result.identification, result.scenario.rig.robot
    paper = robot.settings.get("paper", {})
    for model in models(robot):
        title = f"{model.capitalize()} model{' beside Table II' if paper else ''}, mm"
        table = parameter_table(title, document[model], found.parameters, paper_table(robot), model)
        print_table(console, table)
        reported = paper.get(f"residual_{model}_mm")
        beside = " (paper {}, {}, {})".format(*reported) if reported else ""
        console.print(residual_line(document[model], beside))
        console.print(placements_line(document[model]))
        angles = result.experiment.measurements.joint_angles
        print_correlations(console, document[model]["correlations"], found.parameters, angles)
        console.print()
    print_experiment(console, result.experiment, len(result.scenario.plan), paper)
    console.print(LEGEND)
    mass = document["total_mass"]
    console.print(
        f"Total mass {mass['estimate']:.3f} +- {mass['standard_error']:.3f} kg "
        f"(truth {mass['truth']:.3f} kg)."
    )
    console.print(sag_line(result.experiment))
    console.print(books_line(document["books"]))
    print_table(console, check_table(result.checks))
    colour = COLOURS[result.verdict]
    console.print(f"Verdict: [{colour}]{result.verdict}[/] after {result.wall_s:.0f} s")


def print_experiment(
    console: Console,
    experiment: Experiment | StaticRun,
    planned: int,
    paper: dict[str, Any],
    reasons: bool = True,
) -> None:
    """How many postures could be used and, if `reasons`, why the others could not."""
    dropped = experiment.dropped
    beside = f" (paper {paper['postures_used']} of {paper['postures_planned']})" if paper else ""
    console.print(
        f"Usable postures: {planned - len(dropped)} of {planned}{beside}; "
        f"{len(experiment.measurements)} rows with repeats."
    )
    tally: dict[str, int] = {}
    for _, reason in dropped if reasons else ():
        key = reason.rsplit(" ", 1)[0] if reason.startswith(("lost", "lifted")) else reason
        key = "slipped" if reason.startswith("slipped") else key
        tally[key] = tally.get(key, 0) + 1
    for reason, count in sorted(tally.items(), key=lambda item: -item[1]):
        console.print(f"  dropped {count}: {reason}")
