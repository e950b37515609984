"""What a person reads of a Monte Carlo in the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tulip_testbed.experiments.montecarlo.calibration_verdict import BIAS, COVERAGE, LEVEL, RATIO
from tulip_testbed.experiments.parameter_tables import COLOURS
from tulip_testbed.experiments.terminal import print_table

LEGEND = (
    "bias: mean error, with its Monte Carlo error; ratio: s.d. of the errors over the reported s.e., with "
    "its 95 % interval; coverage: share of runs whose 50, 90 and 95 % intervals hold the truth, the last "
    "with its 95 % interval."
)


SHOWN = {True: "shown", False: "not shown"}


def print_report(console: Console, report: dict[str, Any]) -> None:
    """Tables, distributions and verdict."""
    print_table(console, parameter_table("Full model", report["parameters"]))
    _print_model(console, report)
    for pair, rho in report["correlations"].items():
        console.print(f"Correlation ({pair.replace(',', ', ')}): {_spread(rho, '.4f')}")
    if report["simplified"]["parameters"]:
        print_table(console, parameter_table("Simplified model", report["simplified"]["parameters"]))
        _print_model(console, report["simplified"])
    mass = report["total_mass"]
    if mass["bias"] is not None:
        console.print(
            f"Total mass: bias {1e3 * mass['bias']:+.2f} +- {1e3 * mass['bias_mc_error']:.2f} g, "
            f"ratio {mass['standard_error_ratio']:.3f}, coverage {100 * mass['coverage95']:.1f} %"
        )
    console.print(f"Rows measured: {_spread(report['rows'], '.1f')}")
    for reason, count in report["failures"].items():
        console.print(f"{count} runs not identified: {reason}", markup=False)
    console.print(LEGEND)
    print_table(console, check_table(report["checks"]))
    colour = COLOURS[report["verdict"]]
    shown = f", {SHOWN[report['shown']]}" if report["verdict"] == "pass" else ""
    console.print(
        f"Verdict on '{report['estimator']}' after {report['runs']} runs: "
        f"[{colour}]{report['verdict']}[/]{shown}"
    )
    if report["verdict"] == "pass" and not report["shown"]:
        console.print(
            "These runs do not suffice to show every check: nothing contradicts the estimator, but its "
            "intervals still reach beyond the bounds. More runs, in a new folder, narrow them."
        )


def parameter_table(title: str, rows: list[dict[str, Any]]) -> Table:
    """Bias, ratio and coverage of every parameter, mm and %."""
    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("nr", justify="right")
    table.add_column("parameter", no_wrap=True)
    headers = (
        *("bias\nmm", "+-", "s.e.\nmm", "ratio\ns.d./s.e.", "its 95 %\ninterval"),
        *("coverage %\nof 50 %", "of\n90 %", "of\n95 %", "its 95 %\ninterval"),
    )
    for header in headers:
        table.add_column(header, justify="right", no_wrap=True)
    for row in rows:
        figures = [""] * len(headers)
        if row["bias"] is not None:
            figures = [
                f"{1e3 * row['bias']:+.3f}",
                f"{1e3 * row['bias_mc_error']:.3f}",
                f"{1e3 * row['standard_error']:.2f}",
                f"{row['standard_error_ratio']:.3f}",
                _interval(row["standard_error_ratio_interval"], ".2f"),
                *(f"{100 * row[f'coverage{level}']:.1f}" for level in (50, 90, 95)),
                _interval([100 * end for end in row["coverage95_interval"]], ".1f"),
            ]
        table.add_row(str(row["number"]), escape(row["name"]), *figures)
    return table


def check_table(checks: list[dict[str, Any]]) -> Table:
    """The verdict, line by line."""
    title = (
        f"Verdict: bias within {BIAS[1]:g} s.e., ratio {RATIO[0]:g} to {RATIO[1]:g}, coverage "
        f"{100 * COVERAGE[0]:g} to {100 * COVERAGE[1]:g} %; chance to fail inside of them below {LEVEL:.0%}"
    )
    table = Table(title=title, title_justify="left", header_style="bold")
    for header in ("check", "result", "shown", "worst nr", "value", "interval", "bounds"):
        table.add_column(header)
    notes = any(check["result"] == "not evaluated" or check["beyond"] for check in checks)
    if notes:
        table.add_column("beyond")
    for check in checks:
        result = check["result"]
        numbers = ", ".join(map(str, check["beyond"]))
        table.add_row(
            escape(check["name"]),
            f"[{COLOURS[result]}]{result}[/]",
            "" if result == "not evaluated" else "yes" if check["shown"] else "no",
            "" if check["number"] is None else str(check["number"]),
            "" if check["value"] is None else f"{check['value']:.4f}",
            "" if check["interval"] is None else _interval(check["interval"], ".4f"),
            "" if check["bounds"] is None else _interval(check["bounds"], ".2g"),
            *([escape(check["source"]) if result == "not evaluated" else numbers] if notes else []),
        )
    return table


def _print_model(console: Console, model: dict[str, Any]) -> None:
    console.print(f"Condition number: {_spread(model['condition_number'], '.0f')}")
    console.print(f"Residual sigma (eq. 14): {_spread(model['sigma_mm'], '.3f')} mm")
    norms = ", ".join(
        f"{what} {model[f'residual_{what}_mm']['mean']:.2f} +- {model[f'residual_{what}_mm']['sd']:.2f}"
        for what in ("mean", "sd", "max")
    )
    console.print(f"Residual norms (eq. 12), over the runs: {norms} mm")
    beyond = model["beyond_95"]
    if beyond is not None:
        interval = _interval([100 * end for end in beyond["interval"]], ".1f")
        console.print(
            f"Runs whose errors together exceed 95 % of F: {100 * beyond['share']:.1f} % ({interval})"
        )


def _spread(found: dict[str, float], style: str) -> str:
    mean, sd, low, high = (format(found[key], style) for key in ("mean", "sd", "quantile05", "quantile95"))
    return f"{mean} +- {sd}, 5 to 95 %: {low} to {high}"


def _interval(ends: Any, style: str) -> str:
    return f"{ends[0]:{style}} to {ends[1]:{style}}"
