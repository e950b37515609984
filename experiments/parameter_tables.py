"""Tables of parameters: estimates with the truth and the paper, links, parts of a model."""

from __future__ import annotations

import csv
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import read_text
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.correlation_table import united_links
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.rank import describe_combinations, labels, weakly_known
from tulip_testbed.identification.statistics import WELL_IDENTIFIED
from tulip_testbed.sim.robot import Robot

LEGEND = (
    "s.e.: standard error by the estimator (least squares: eq. 14); clustered s.e.: allows for errors common "
    "to a placement; relative s.e.: s.e. over the estimate (eq. 13); well identified: relative s.e. below "
    f"{WELL_IDENTIFIED:.0f} %."
)
NOT_AT_REST = "The estimate did not come to rest: these numbers and their standard errors mean nothing."
MOST_TABLE = 2**20  # bytes
NO_PLACEMENT_SD = 1e-3  # of sigma
PAPER_COLUMNS = tuple(
    f"{model}_{what}" for model in ("full", "simplified") for what in ("mm", "rel_se_percent")
)


@dataclass(frozen=True)
class Reported:
    """The values that the paper reports of a robot.

    Attributes:
        parameters: Table II, values [mm, %] by column of `PAPER_COLUMNS` and number of the parameter.
        residual: mean, s.d. and maximum of the residual norm by model [mm].
    """

    parameters: dict[int, dict[str, float | None]]
    residual: dict[str, list[float]]


def read_reported(robot: Robot) -> Reported | None:
    """Read what the paper reports of a robot; None where its description names no paper.

    Raises:
        InputError: the file lies outside of the robot's folder or is no such table.
    """
    paper = robot.settings.get("paper")
    if paper is None:
        return None
    found = {model: paper.get(f"residual_{model}_mm") for model in ("full", "simplified")}
    residual = {model: norms for model, norms in found.items() if norms}
    return Reported({} if paper.get("table") is None else _paper_table(robot, paper["table"]), residual)


def _paper_table(robot: Robot, name: str) -> dict[int, dict[str, float | None]]:
    path = robot.folder / name
    if "\0" in name or not Path(os.path.realpath(path)).is_relative_to(robot.folder):
        raise InputError(
            f"{robot.path}: key 'paper.table': found '{name}', expected a file in {robot.folder}"
        )
    rows = csv.DictReader(io.StringIO(read_text(path, MOST_TABLE)))
    table: dict[int, dict[str, float | None]] = {}
    expected = f"numbers in the columns number, {', '.join(PAPER_COLUMNS)}"
    try:
        for row in rows:
            values = {column: float(row[column]) if row[column] else None for column in PAPER_COLUMNS}
            table[int(row["number"])] = values
            whole = None not in row and None not in row.values()
            if not whole or not all(math.isfinite(value) for value in values.values() if value is not None):
                raise ValueError
    except (KeyError, TypeError, ValueError, csv.Error):
        raise InputError(f"{path}: line {rows.line_num}: not a table of {expected}") from None
    if not table:
        raise InputError(f"{path}: found no row, expected {expected}")
    return table


def models(robot: Robot) -> tuple[str, ...]:
    """Return the models that differ: without a simplified one the second would be the first."""
    return ("full", "simplified") if "simplified" in robot.settings else ("full",)


def parameter_table(
    model: str,
    document: dict[str, Any],
    parameters: BaseParameters,
    paper: Reported | None = None,
    at_rest: bool = True,
    least_squares: dict[str, Any] | None = None,
) -> Table:
    """Return a model's parameters, with the truth and the paper's Table II where these are known.

    Args:
        model: "full" or "simplified". document: a `ModelReport` as plain JSON.
        paper: see `read_reported`; None: without.
        at_rest: whether the estimator's iteration ended; otherwise no parameter is well identified.
        least_squares: the paper's estimate from the same data, likewise; compared with Table II.
    """
    rows = document["parameters"]

    def values(name: str) -> list[Cell]:
        return [Cell(row[name], f"{model}.parameters.{k}.{name}") for k, row in enumerate(rows)]

    shares = [row["relative_standard_error"] for row in rows]
    well = [at_rest and share is not None and share < WELL_IDENTIFIED for share in shares]
    columns: list[tuple[Column, list[Any]]] = [
        (Column("no.", format="d"), values("number")),
        (Column("parameter"), values("name")),
        (_millimetres("estimate"), values("estimate")),
        (_millimetres("s.e."), values("standard_error")),
        (Column("relative s.e.", "%", ".1f"), values("relative_standard_error")),
        (Column("well identified"), [Cell(yes, mark="good" if yes else "") for yes in well]),
    ]
    # The default's own standard errors allow for placements: then the clustered ones would repeat them.
    if any(row["clustered_standard_error"] != row["standard_error"] for row in rows):
        columns.insert(4, (_millimetres("clustered s.e."), values("clustered_standard_error")))
    if rows[0]["truth"] is not None:
        columns.insert(3, (_millimetres("error", "+.2f"), [row["estimate"] - row["truth"] for row in rows]))
        columns.insert(2, (_millimetres("truth"), values("truth")))
    beside = paper is not None and bool(paper.parameters)
    if least_squares:
        columns += _least_squares_columns(model, least_squares)
    if paper and beside:
        columns += _paper_columns(model, (least_squares or document)["parameters"], paper)
    columns.append((Column("links", extra=True), [united_links(parameters, row["number"]) for row in rows]))
    title = f"{model.capitalize()} model{', compared with Table II' if beside else ''}"
    shown = least_squares or document
    note = f"{residual_line(shown, model, paper)} {placements_line(shown)}"
    if least_squares:
        note = f"By least squares: {note[0].lower()}{note[1:]}"
    if not at_rest:
        note = f"{NOT_AT_REST} {note}"
    return Table(title, tuple(c for c, _ in columns), list(zip(*(v for _, v in columns), strict=True)), note)


def _least_squares_columns(model: str, document: dict[str, Any]) -> list[tuple[Column, list[Any]]]:
    columns = (("least squares", "estimate"), ("its s.e.", "standard_error"))
    where = f"least_squares.{model}.parameters"
    return [
        (
            _millimetres(title),
            [Cell(row[name], f"{where}.{k}.{name}", "aside") for k, row in enumerate(document["parameters"])],
        )
        for title, name in columns
    ]


def _millimetres(name: str, spec: str = ".2f") -> Column:
    return Column(name, "mm", spec, 1e3)


def _paper_columns(model: str, rows: list[dict[str, Any]], paper: Reported) -> list[tuple[Column, list[Any]]]:
    reported = [paper.parameters.get(row["number"], {}) for row in rows]
    values = [found.get(f"{model}_mm") for found in reported]
    shares = [found.get(f"{model}_rel_se_percent") for found in reported]
    errors = [
        None if v is None or p is None else abs(v) * p / 100 for v, p in zip(values, shares, strict=True)
    ]
    ratios = [1e3 * row["standard_error"] / e if e else None for row, e in zip(rows, errors, strict=True)]
    columns = (
        (Column("paper's estimate", "mm", ".2f", extra=True), values),
        (Column("paper's relative s.e.", "%", ".1f", extra=True), shares),
        (Column("paper's s.e.", "mm", ".2f", extra=True), errors),
        (Column("s.e. over paper's", "", ".2f", extra=True), ratios),
    )
    return [(column, [Cell(value, mark="aside") for value in found]) for column, found in columns]


def standard_table(model: str, links: list[dict[str, Any]], visible: str) -> Table:
    """Return masses and centres of mass of the links and how much of each came from the data.

    Args:
        links: `LinkRow`s as plain JSON. visible: which masses the measurements can give at all.
    """
    columns = [
        Column("link"),
        Column("mass", "kg", ".3f"),
        Column("s.e. of mass", "kg", ".3f"),
        Column("mass from data", "%", ".0f", 100),
    ]
    for axis in "xyz":
        columns += [
            Column(axis, "mm", ".1f", 1e3),
            Column(f"s.e. of {axis}", "mm", ".1f", 1e3),
            Column(f"{axis} from data", "%", ".0f", 100, extra=True),
        ]
    rows = []
    for k, row in enumerate(links):
        of_mass = ("mass", "mass_standard_error", "mass_data_share")
        of_center = zip(row["center"], row["center_standard_error"], row["center_data_share"], strict=True)
        rows.append(
            [
                row["link"],
                *(Cell(row[name], f"{model}.links.{k}.{name}") for name in of_mass),
                *(value for axis in of_center for value in axis),
            ]
        )
    note = f"From data: share of the prior's variance that the measurements took away. {visible}"
    return Table("Masses and centres of mass of the links", tuple(columns), rows, note)


def weak_directions(estimate: Estimate, parameters: BaseParameters) -> str:
    """Describe which parameters the postures hardly distinguish: those with an error beyond the longest link.

    Returns:
        "" where there are none.
    """
    longest = float(np.abs(parameters.from_standard[:, ::4]).max())
    weak = weakly_known(estimate.clustered_covariance, longest)
    if not len(weak):
        return ""
    text = describe_combinations(weak, labels(estimate.numbers, estimate.names))
    return f"to within the longest link ({1e3 * longest:.0f} mm), {text}"


def placements_line(document: dict[str, Any]) -> str:
    """Describe the errors that the postures of a placement share."""
    right, left = document["placement_sd_mm"]
    if max(right, left) < NO_PLACEMENT_SD * document["sigma_mm"]:
        return (
            "The errors common to the postures of a placement are estimated as 0, so the clustered s.e. "
            "equals the s.e.; this happens often with few placements."
        )
    return f"Errors common to a placement: s.d. {right:.2f} mm of the right plate, {left:.2f} mm of the left."


def residual_line(document: dict[str, Any], model: str = "full", paper: Reported | None = None) -> str:
    """Describe a model's residual (eqs 12 and 14) and its condition number."""
    norms, condition = document["residual_mm"], document["condition_number"]
    reported = paper.residual.get(model) if paper else None
    beside = " (paper: {:g}, {:g}, {:g})".format(*reported) if reported else ""
    return (
        f"Residual norm: mean {norms['mean']:.2f}, s.d. {norms['sd']:.2f}, max {norms['max']:.2f} mm"
        f"{beside}; sigma per axis (eq. 14) {document['sigma_mm']:.3f} mm; condition number {condition:.0f}."
    )


def mass_line(mass: float, standard_error: float, truth: float | None = None) -> str:
    """Describe the total mass [kg]."""
    beside = "" if truth is None else f", truth {truth:.3f} kg"
    return f"Total mass {mass:.3f} kg, standard error {standard_error:.3f} kg{beside}."
