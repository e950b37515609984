"""Tables and sentences of parameters: estimates with the truth and the paper, links, what can be used."""

import csv
import io
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import read_text
from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Array
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.correlations import united_links
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.estimators import Estimate, StandardEstimate
from tulip_testbed.identification.rank import describe_combinations, labels, weakly_known
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, relative_standard_errors, residual_norms
from tulip_testbed.sim.robot import Robot

LEGEND = (
    "s.e.: standard error by the estimator (least squares: eq. 14); relative s.e.: s.e. over the estimate "
    f"(eq. 13); well identified: relative s.e. below {WELL_IDENTIFIED:.0f} %."
)
NOT_AT_REST = "The estimate did not come to rest: these numbers and their standard errors mean nothing."
HALF, LEADING = 0.5, 5  # share of data, directions that are listed
MOST_TABLE = 2**20  # bytes
NO_PLACEMENT_SD = 1e-3  # of sigma
PAPER_COLUMNS = tuple(
    f"{model}_{what}" for model in ("full", "simplified") for what in ("mm", "rel_se_percent")
)


def cad_line(shares: np.ndarray, scales: tuple[float, float]) -> str:
    """Say how much of an estimate with CAD as prior is data.

    Args:
        shares: of every direction's prior variance that the data removed, (p,).
        scales: of the prior's s.d. of masses and centres of mass.
    """
    mass, center = 100 * MASS_SD * scales[0], 1e3 * CENTER_SD * scales[1]
    known, most = int((shares > HALF).sum()), ", ".join(f"{100 * share:.0f} %" for share in shares[:LEADING])
    return (
        f"The postures do not determine all {len(shares)} parameters, so CAD is the prior (by their "
        f"likelihood {mass:.2g} % of each mass and {center:.2g} mm of each centre). In {known} independent "
        f"directions more than half is data (the first: {most})."
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
    """Read what the paper reports of a robot; None where its description names no paper."""
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
    estimate: Estimate,
    parameters: BaseParameters,
    truth: np.ndarray | None = None,
    paper: Reported | None = None,
    at_rest: bool = True,
    least_squares: Estimate | None = None,
    cad: np.ndarray | None = None,
) -> Table:
    """Return a model's parameters, with the truth and the paper's Table II where these are known.

    Args:
        model: "full" or "simplified".
        truth: all base parameters, (p,) [m]; None: unknown.
        paper: see `read_reported`; None: without.
        at_rest: whether the estimator's iteration ended; otherwise no parameter is well identified.
        least_squares: the paper's estimate from the same data; compared with Table II.
        cad: all base parameters by CAD, (p,) [m], which the table shows where CAD was a prior; None: without.
    """
    well = [at_rest and bool(known) for known in estimate.well_identified]
    columns: list[tuple[Column, Sequence[Any]]] = [
        (Column("no.", format="d"), estimate.numbers.tolist()),
        (Column("parameter"), estimate.names),
        (_millimetres("estimate"), estimate.value.tolist()),
        (_millimetres("s.e."), estimate.standard_error.tolist()),
        (Column("relative s.e.", "%", ".1f"), estimate.relative_standard_error.tolist()),
        (Column("well identified"), [Cell(yes, "good" if yes else "") for yes in well]),
    ]
    # The default's own standard errors allow for placements: then the clustered ones would repeat them.
    clustered = (estimate.clustered_standard_error != estimate.standard_error).any()
    if clustered:
        columns.insert(4, (_millimetres("clustered s.e."), estimate.clustered_standard_error.tolist()))
    if truth is not None:
        kept = truth[estimate.numbers - 1]
        columns.insert(3, (_millimetres("error", "+.2f"), (estimate.value - kept).tolist()))
        columns.insert(2, (_millimetres("truth"), kept.tolist()))
    shown = least_squares or estimate
    if least_squares:
        columns += [
            (_millimetres("least squares"), _aside(least_squares.value.tolist())),
            (_millimetres("its s.e."), _aside(least_squares.standard_error.tolist())),
        ]
    beside = paper is not None and bool(paper.parameters)
    if paper and beside:
        columns += _paper_columns(model, shown, paper)
    links = [united_links(parameters, number) for number in estimate.numbers.tolist()]
    if estimate.data_share is not None:
        columns.append((Column("from data", "%", ".0f", 100), estimate.data_share.tolist()))
        if cad is not None:
            nominal = cad[estimate.numbers - 1]
            off = (estimate.value - nominal) / estimate.standard_error
            columns.append((_millimetres("CAD"), nominal.tolist()))
            columns.append((Column("off CAD", "s.e.", "+.1f"), off.tolist()))
    columns.append((Column("links", extra=True), links))
    title = f"{model.capitalize()} model{', compared with Table II' if beside else ''}"
    note = f"{residual_line(shown, model, paper)} {placements_line(shown)}"
    note += " Clustered s.e.: allows for these." * bool(clustered)
    if least_squares:
        note = f"By least squares: {note[0].lower()}{note[1:]}"
    if not at_rest:
        note = f"{NOT_AT_REST} {note}"
    return Table(title, tuple(c for c, _ in columns), list(zip(*(v for _, v in columns), strict=True)), note)


def _aside(values: list[Any]) -> list[Cell]:
    return [Cell(value, "aside") for value in values]


def _millimetres(name: str, spec: str = ".2f") -> Column:
    return Column(name, "mm", spec, 1e3)


def _paper_columns(model: str, estimate: Estimate, paper: Reported) -> list[tuple[Column, list[Any]]]:
    reported = [paper.parameters.get(number, {}) for number in estimate.numbers.tolist()]
    values = [row.get(f"{model}_mm") for row in reported]
    shares = [row.get(f"{model}_rel_se_percent") for row in reported]
    errors = [
        None if v is None or p is None else abs(v) * p / 100 for v, p in zip(values, shares, strict=True)
    ]
    ratios = [
        1e3 * own / error if error else None
        for own, error in zip(estimate.standard_error.tolist(), errors, strict=True)
    ]
    columns = (
        (Column("paper's estimate", "mm", ".2f", extra=True), values),
        (Column("paper's relative s.e.", "%", ".1f", extra=True), shares),
        (Column("paper's s.e.", "mm", ".2f", extra=True), errors),
        (Column("s.e. over paper's", "", ".2f", extra=True), ratios),
    )
    return [(column, _aside(of_column)) for column, of_column in columns]


def standard_table(standard: StandardEstimate) -> Table:
    """Return masses and centres of mass of the links and how much of each came from the data."""
    of_mass = ("mass", "kg", ".3f"), ("s.e. of mass", "kg", ".3f"), ("mass from data", "%", ".0f", 100)
    heads = ("link", *of_mass)
    for axis in "xyz":
        both = (axis, "mm", ".1f", 1e3), (f"s.e. of {axis}", "mm", ".1f", 1e3)
        heads += (*both, (f"{axis} from data", "%", ".0f", 100, True))
    masses = np.column_stack([standard.mass, standard.mass_error, standard.mass_share])
    centers = np.stack([standard.center, standard.center_error, standard.center_share], axis=2)
    rows = [
        [link, *mass, *center.ravel().tolist()]
        for link, mass, center in zip(standard.links, masses.tolist(), centers, strict=True)
    ]
    note = (
        f"From data: share of the prior's variance that the measurements took away. {standard.identifiable}"
    )
    return Table("Masses and centres of mass of the links", heads, rows, note)


def weak_directions(estimate: Estimate, parameters: BaseParameters) -> str:
    """Describe which parameters have an error beyond the longest link, "" if none has."""
    longest = float(np.abs(parameters.from_standard[:, ::4]).max())
    weak = weakly_known(estimate.clustered_covariance, longest)
    if not len(weak):
        return ""
    text = describe_combinations(weak, labels(estimate.numbers, estimate.names))
    return f"to within the longest link ({1e3 * longest:.0f} mm), {text}"


def placements_line(estimate: Estimate) -> str:
    right, left = estimate.placement_sd
    if max(right, left) < NO_PLACEMENT_SD * estimate.sigma:
        return (
            "The errors common to the postures of a placement are estimated as 0, so the clustered s.e. "
            "equals the s.e.; this happens often with few placements."
        )
    return (
        f"Errors common to a placement: s.d. {1e3 * right:.2f} mm under the right foot, {1e3 * left:.2f} mm "
        "under the left."
    )


def residual_line(estimate: Estimate, model: str = "full", paper: Reported | None = None) -> str:
    """Describe a model's residual (eqs 12 and 14) and its condition number."""
    norms = residual_norms(estimate.residual)
    reported = paper.residual.get(model) if paper else None
    beside = " (paper: {:g}, {:g}, {:g})".format(*reported) if reported else ""
    return (
        f"Residual norm: mean {1e3 * norms.mean:.2f}, s.d. {1e3 * norms.sd:.2f}, max {1e3 * norms.max:.2f} mm"
        f"{beside}; sigma per axis (eq. 14) {1e3 * estimate.sigma:.3f} mm; condition number "
        f"{estimate.condition_number:.0f}."
    )


def mass_line(mass: float, standard_error: float, truth: float | None = None) -> str:
    beside = "" if truth is None else f", truth {truth:.3f} kg"
    return f"Total mass {mass:.3f} kg, standard error {standard_error:.3f} kg{beside}."


@dataclass(frozen=True, eq=False)
class ConstantError:
    """The mean residual of the centre of pressure, which the estimate takes as the laboratory's.

    Attributes:
        mean: residual over all rows, in x and y, (2,) [m]. half_width: of its 95 % interval, (2,) [m].
        share: of the residuals' mean square, (2,).
    """

    mean: Array
    half_width: Array
    share: Array

    def __str__(self) -> str:
        x, y = (
            f"{number(1e3 * mean, '+.2f')} ± {number(1e3 * half, '.2f')} mm ({number(100 * share, '.0f')} %)"
            for mean, half, share in zip(self.mean, self.half_width, self.share, strict=True)
        )
        return (
            f"Constant error of the centre of pressure (share of the residuals' mean square): x {x}, y {y}. "
            "It is taken as the laboratory's, such as plates and tilt, and is in no parameter."
        )


def known_sums(estimate: Estimate) -> Iterator[str]:
    """Yield sums and differences that are well known though neither of their two parameters is."""
    shares = dict(zip(estimate.numbers.tolist(), estimate.relative_standard_error, strict=True))
    for first, second, correlation in estimate.high_correlations:
        sign = -1.0 if correlation > 0 else 1.0
        weights = (estimate.numbers == first) + sign * (estimate.numbers == second)
        value, error = weights @ estimate.value, np.sqrt(weights @ estimate.covariance @ weights)
        if relative_standard_errors(value, error) < WELL_IDENTIFIED <= min(shares[first], shares[second]):
            names = [estimate.names[list(shares).index(one)] for one in (first, second)]
            size = f"{1e3 * value:.2f} mm, standard error {1e3 * error:.2f} mm"
            yield f"{(' + ' if sign > 0 else ' - ').join(names)} = {size}."


def usable_line(well: np.ndarray, missed: float, sums: int = 0) -> str:
    """Say how much of a full model can be used.

    Args:
        well: which parameters are well identified, (p,) bool. missed: standard error of the predicted centre
            of mass per axis [m]. sums: see `known_sums`.
    """
    others = f" and {sums} sum{'s' * (sums > 1)} of others" if sums else ""
    return (
        f"Usable: {well.sum()} of {len(well)} parameters{others} are known better "
        f"than {WELL_IDENTIFIED:.0f} %; the centre of mass of these postures is predicted within "
        f"± {number(1.96e3 * float(missed), '.2g')} mm per axis (95 %)."
    )
