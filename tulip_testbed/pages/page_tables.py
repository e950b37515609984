"""The page's tables: every figure with the place in the run's JSON that it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tulip_testbed.experiments.correlation_table import meaning
from tulip_testbed.experiments.document import flattened
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.statistics import WELL_IDENTIFIED


@dataclass(frozen=True)
class Cell:
    """One cell.

    Attributes:
        text: as shown. key: path in the run's JSON, with dots; "" for what is not from there.
        value: as the JSON has it.
        style: class of the cell.
    """

    text: str
    key: str = ""
    value: float | str | None = None
    style: str = ""


@dataclass(frozen=True)
class Table:
    """Cells under headers."""

    title: str
    headers: tuple[str, ...]
    rows: list[list[Cell]]
    note: str = ""


def number(key: str, value: float | None, style: str, scale: float = 1.0, css: str = "number") -> Cell:
    """A figure of the JSON, shown in a format of its own; empty for null."""
    return Cell("" if value is None else format(scale * value, style), key, value, css)


def check_table(checks: list[dict[str, Any]]) -> Table:
    """The verdict's checks."""
    rows = []
    for k, check in enumerate(checks):
        key = f"checks.{k}"
        limit = check.get("threshold", check.get("bounds"))
        rows.append(
            [
                Cell(check["name"], f"{key}.name", check["name"]),
                Cell(check["result"], f"{key}.result", check["result"], check["result"].replace(" ", "-")),
                number(f"{key}.value", check["value"], ".4g"),
                Cell(_limit(limit), style="number"),
                Cell(check["source"], f"{key}.source", check["source"]),
            ]
        )
    return Table("Checks", ("check", "result", "value", "threshold", "where it comes from"), rows)


def parameter_table(
    model: str, document: dict[str, Any], parameters: BaseParameters, paper: dict[int, dict[str, str]]
) -> Table:
    """A model's parameters of a validation beside those of the paper, mm.

    Args:
        document: the model's part of report.json.
        paper: Table II by number, or {}.
    """
    beside = ("paper", "paper rel. %", "paper s.e.") if paper else ()
    headers = ("nr", "parameter", "truth", "estimate", "error", "s.e.", "rel. %", "well id.", *beside)
    rows = []
    for k, row in enumerate(document["parameters"]):
        key, nr = f"{model}.parameters.{k}", row["number"]
        relative = row["relative_standard_error"]
        cells = [
            Cell(str(nr), f"{key}.number", nr, "number"),
            Cell(meaning(parameters, nr)),
            number(f"{key}.truth", row["truth"], ".2f", 1e3),
            number(f"{key}.estimate", row["estimate"], ".2f", 1e3),
            Cell(f"{1e3 * (row['estimate'] - row['truth']):+.2f}", style="number"),
            number(f"{key}.standard_error", row["standard_error"], ".2f", 1e3),
            number(f"{key}.relative_standard_error", relative, ".1f"),
            Cell("yes" if relative is not None and relative < WELL_IDENTIFIED else "no"),
        ]
        rows.append(cells + (_paper_cells(paper.get(nr, {}), model) if paper else []))
    title = f"{model.capitalize()} model{' beside Table II' if paper else ''}, mm"
    return Table(title, headers, rows, _residual_note(document))


def calibration_table(model: str, rows: list[dict[str, Any]], path: str) -> Table:
    """A model's parameters of a Monte Carlo: bias, standard errors, coverage.

    Args:
        path: of the rows in the report's JSON.
    """
    headers = ("nr", "parameter", "bias", "± MC", "stated s.e.", "found s.e.", "found/stated")
    cells = []
    for k, row in enumerate(rows):
        key = f"{path}.{k}"
        cells.append(
            [
                Cell(str(row["number"]), f"{key}.number", row["number"], "number"),
                Cell(str(row["name"] or ""), f"{key}.name", row["name"]),
                number(f"{key}.bias", row["bias"], "+.3f", 1e3),
                number(f"{key}.bias_mc_error", row["bias_mc_error"], ".3f", 1e3),
                number(f"{key}.standard_error", row.get("standard_error"), ".3f", 1e3),
                number(f"{key}.empirical_standard_error", row.get("empirical_standard_error"), ".3f", 1e3),
                number(f"{key}.standard_error_ratio", row["standard_error_ratio"], ".3f"),
                *(number(f"{key}.coverage{n}", row.get(f"coverage{n}"), ".3f") for n in (50, 90, 95)),
            ]
        )
    coverage = tuple(f"cov. {n} %" for n in (50, 90, 95))
    return Table(f"{model.capitalize()} model, mm", headers + coverage, cells)


def settings_table(document: dict[str, Any]) -> Table:
    """Everything in run.json, one value a row."""
    rows = [
        [Cell(key), Cell(_plain(value), f"run.{key}", value)] for key, value in flattened(document).items()
    ]
    return Table("Settings, versions, seed and hashes", ("key", "value"), rows)


def _plain(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _limit(limit: Any) -> str:
    if limit is None:
        return ""
    if isinstance(limit, list | tuple):
        return f"{limit[0]:.4g} to {limit[1]:.4g}"
    return f"at most {limit:.4g}"


def _paper_cells(reported: dict[str, str], model: str) -> list[Cell]:
    value, relative = reported.get(f"{model}_mm"), reported.get(f"{model}_rel_se_percent")
    if not value or not relative:
        return [Cell(""), Cell(""), Cell("")]
    error = abs(float(value)) * float(relative) / 100
    return [Cell(text, style="number paper") for text in (value, relative, f"{error:.2f}")]


def _residual_note(document: dict[str, Any]) -> str:
    norms = document["residual_mm"]
    return (
        f"Residual norm: mean {norms['mean']:.2f}, s.d. {norms['sd']:.2f}, max {norms['max']:.2f} mm; "
        f"sigma per axis (eq. 14) {document['sigma_mm']:.3f} mm; "
        f"condition number {document['condition_number']:.0f}."
    )
