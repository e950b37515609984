"""Tables and sentences of a Monte Carlo, from its report."""

from __future__ import annotations

from typing import Any

from tulip_testbed.base.column import Column
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.imperfections import imperfections_line
from tulip_testbed.experiments.montecarlo.coverage_verdict import BIAS, COVERAGE, LEVEL, RATIO

LEGEND = (
    "bias: mean error; its s.e.: by the number of runs; stated s.e.: by the estimator; found s.e.: s.d. of "
    "the errors over the runs; coverage: share of the runs whose 95 % intervals hold the truth. "
    "Intervals are of 95 % for every single number; those of the checks are wider, since they hold for all "
    "at once."
)


def coverage_table(model: str, rows: list[dict[str, Any]]) -> Table:
    """Return bias, standard errors and coverage of a model's parameters.

    Args:
        model: "full" or "simplified". rows: its parameters, as a report has them.
    """
    columns = (
        Column("no.", format="d"),
        Column("parameter"),
        Column("bias", "mm", "+.3f", 1e3),
        Column("s.e. of bias", "mm", ".3f", 1e3),
        Column("stated s.e.", "mm", ".3f", 1e3),
        Column("found s.e.", "mm", ".3f", 1e3, extra=True),
        Column("found over stated", "", ".3f"),
        Column("its interval", "", ".2f", extra=True),
        Column("coverage of 95 %", "%", ".1f", 100),
        Column("its 95 % interval", "%", ".1f", 100, extra=True),
    )
    names = (
        *("number", "name", "bias", "bias_mc_error", "standard_error", "empirical_standard_error"),
        *("standard_error_ratio", "standard_error_ratio_interval"),
        *("coverage95", "coverage95_interval"),
    )
    path = "parameters" if model == "full" else f"{model}.parameters"
    lines = [[Cell(row[name], f"{path}.{k}.{name}") for name in names] for k, row in enumerate(rows)]
    return Table(f"{model.capitalize()} model", columns, lines)


def coverage_check_table(checks: list[dict[str, Any]]) -> Table:
    """Return the checks of the verdict."""
    columns = (
        Column("check"),
        Column("result"),
        Column("worst no.", format="d"),
        Column("value", format=".4f"),
        Column("interval", format=".4f"),
        Column("bounds", format=".2g"),
        Column("beyond, no.", extra=True),
        Column("where the bounds come from", extra=True),
    )
    rows = []
    for k, check in enumerate(checks):
        name, *others = (
            Cell(check[key], f"checks.{k}.{key}")
            for key in ("name", "number", "value", "interval", "bounds", "beyond", "source")
        )
        result = check["result"] if check["shown"] or check["result"] != "pass" else "inconclusive"
        rows.append([name, Cell(result, mark=result), *others])
    note = (
        f"Bounds: bias within {BIAS[1]:g} s.e., found over stated s.e. {RATIO[0]:g} to {RATIO[1]:g}, "
        f"coverage {100 * COVERAGE[0]:g} to {100 * COVERAGE[1]:g} %. Judged are the errors that "
        "are left if imperfections which the data do not show were known. An estimator inside of the bounds "
        f"fails with a probability below {100 * LEVEL:g} %. Pass: the runs show it, by intervals "
        "wholly inside of the bounds; inconclusive: some still reach beyond them."
    )
    return Table("Checks", columns, rows, note)


def coverage_lines(report: dict[str, Any]) -> list[str]:
    """Describe the total mass, the errors of all parameters together, and the runs that failed."""
    lines = [imperfections_line(report["imperfections"], several=True)]
    for model, figures in (("full", report), ("simplified", report["simplified"])):
        if beyond := figures["beyond_95"]:
            low, high = (100 * end for end in beyond["interval"])
            lines.append(
                f"Runs whose errors together exceed 95 % of F, {model} model: {100 * beyond['share']:.1f} % "
                f"({low:.1f} to {high:.1f})."
            )
    mass = report["total_mass"]
    if mass["bias"] is not None:
        lines.append(
            f"Total mass: bias {_figure(mass['bias'], '+.2f', 1e3)} g, its s.e. "
            f"{_figure(mass['bias_mc_error'], '.2f', 1e3)} g; found over stated s.e. "
            f"{_figure(mass['standard_error_ratio'], '.3f')}, coverage of 95 % intervals "
            f"{_figure(mass['coverage95'], '.1f', 100)} %."
        )
    return lines + [f"{count} runs not identified: {reason}" for reason, count in report["failures"].items()]


def _figure(value: float | None, spec: str, scale: float = 1.0) -> str:
    """Format a figure of the report; "-" where the runs are too few for one."""
    return "-" if value is None else number(scale * value, spec)
