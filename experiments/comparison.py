"""Two runs side by side: what was set otherwise and what came out otherwise."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tulip_testbed.experiments.discovery_record import DiscoveryRecord
from tulip_testbed.experiments.document import flattened
from tulip_testbed.experiments.montecarlo.montecarlo_record import MonteCarloRecord
from tulip_testbed.experiments.records import Record
from tulip_testbed.experiments.terminal import print_table
from tulip_testbed.sim.errors import InputError

NOT_SETTINGS = ("outputs",)  # hashes of results: they differ whenever the results do
QUANTITIES = {
    "validation": ("estimate", "standard_error", "truth"),
    "Monte Carlo": ("bias", "standard_error", "standard_error_ratio", "coverage95"),
    "discovery": ("before_mm", "after_mm", "standard_error_mm"),
}


def compare(first: Record, second: Record) -> dict[str, Any]:
    """Compare two runs as one JSON document; lists hold the first run's value, then the second's.

    Raises:
        InputError: runs that cannot be compared; says why.
    """
    _check_alike(first, second)
    both = [_models(first), _models(second)]
    return {
        "runs": [_name(first), _name(second)],
        "verdict": [first.report.verdict, second.report.verdict],
        "settings": differences(first.document.plain(), second.document.plain()),
        "checks": _checks(_judged(first), _judged(second)),
        "models": {
            model: [
                {"number": a["number"], "name": a["name"]}
                | {name: [a.get(name), b.get(name)] for name in QUANTITIES[first.kind]}
                for a, b in zip(both[0][model], both[1][model], strict=True)
            ]
            for model in both[0]
        },
    }


def differences(first: dict[str, Any], second: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the settings that are not the same in both documents, by name."""
    flat = [flattened({k: v for k, v in d.items() if k not in NOT_SETTINGS}) for d in (first, second)]
    names = dict.fromkeys([*flat[0], *flat[1]])
    return {
        name: [flat[0].get(name), flat[1].get(name)]
        for name in names
        if flat[0].get(name) != flat[1].get(name)
    }


def print_comparison(screen: Console, document: dict[str, Any]) -> None:
    """The document as tables."""
    first, second = document["runs"]
    screen.print(f"A: {first}, verdict {document['verdict'][0]}", markup=False)
    screen.print(f"B: {second}, verdict {document['verdict'][1]}", markup=False)
    print_table(screen, _settings_table(document["settings"]))
    judged = any(result for check in document["checks"] for result in check["result"])
    checks = Table(
        title="Checks" if judged else "Gap and evidence", title_justify="left", header_style="bold"
    )
    for header in ("check", "A", "value", "B", "value") if judged else ("", "A", "B"):
        checks.add_column(header, justify="right" if header == "value" else "left")
    for check in document["checks"]:
        (a, b), (x, y) = check["result"], map(_figure, check["value"])
        checks.add_row(check["name"], *((a or "", x, b or "", y) if judged else (x, y)))
    print_table(screen, checks)
    for model, rows in document["models"].items():
        print_table(screen, _model_table(model, rows))


def _name(run: Record) -> str:
    return "in memory" if run.folder is None else str(run.folder)


def _check_alike(first: Record, second: Record) -> None:
    """Refuse what has no common measure."""
    where = f"{_name(first)}, {_name(second)}: cannot be compared"
    if first.kind != second.kind:
        raise InputError(f"{where}: found a {first.kind} and a {second.kind}, expected two of a kind")
    models = [_models(first), _models(second)]
    for model in dict.fromkeys([*models[0], *models[1]]):
        names = [[row["name"] for row in of.get(model, [])] for of in models]
        if names[0] != names[1]:
            raise InputError(
                f"{where}: found {len(names[0])} and {len(names[1])} parameters of the {model} model with "
                "other names, expected the same ones (the same support)"
            )


def _models(run: Record) -> dict[str, list[dict[str, Any]]]:
    report = run.report.plain()
    if isinstance(run, DiscoveryRecord):
        return {"full": report["parameters"]}
    full = report if isinstance(run, MonteCarloRecord) else report["full"]
    return {"full": full["parameters"], "simplified": report["simplified"]["parameters"]}


def _judged(run: Record) -> list[dict[str, Any]]:
    """Return a run's checks; of a discovery the gap by channel, its explanations and their sizes."""
    if not isinstance(run, DiscoveryRecord):
        return run.report.plain()["checks"]
    gap = [
        {"name": f"gap {channel}, {side}", "result": None, "value": getattr(ratio, side)}
        for channel, ratio in run.report.gap.items()
        if ratio is not None
        for side in ("before", "after")
    ]
    explained = []
    for found in run.report.candidates:
        explained.append({"name": f"ln BF {found.label}", "result": None, "value": found.log_bayes_factor})
        for p in found.parameters:
            unit = f" [{p.unit}]" if p.unit else ""
            explained.append({"name": f"{found.label} {p.name}{unit}", "result": None, "value": p.value})
    return gap + explained


def _checks(first: list[dict[str, Any]], second: list[dict[str, Any]]) -> list[dict[str, Any]]:
    of = [{check["name"]: check for check in checks} for checks in (first, second)]
    return [
        {"name": name}
        | {key: [checks.get(name, {}).get(key) for checks in of] for key in ("result", "value")}
        for name in dict.fromkeys([*of[0], *of[1]])
    ]


def _settings_table(settings: dict[str, list[Any]]) -> Table:
    table = Table(title="Settings that differ", title_justify="left", header_style="bold")
    for header in ("setting", "A", "B"):
        table.add_column(header)
    for name, values in settings.items():
        table.add_row(escape(name), *(escape(str(value)) for value in values))
    if not settings:
        table.add_row("none", "", "")
    return table


def _model_table(model: str, rows: list[dict[str, Any]]) -> Table:
    lengths = "mm" if "bias" not in rows[0] else "mm, ratios and shares"
    title = f"{model.capitalize()} model, {lengths}"
    table = Table(title=title, title_justify="left", header_style="bold")
    quantities = [name for name in rows[0] if name not in ("number", "name")]
    table.add_column("nr", justify="right")
    table.add_column("parameter")
    for name in quantities:
        for run in "AB":
            table.add_column(f"{HEADERS[name][0]} {run}", justify="right", no_wrap=True)
    for row in rows:
        cells = []
        for name in quantities:
            _, scale, style = HEADERS[name]
            cells += ["" if value is None else format(scale * value, style) for value in row[name]]
        table.add_row(str(row["number"]), escape(row["name"]), *cells)
    return table


HEADERS = {
    "estimate": ("est.", 1e3, ".2f"),
    "standard_error": ("s.e.", 1e3, ".2f"),
    "truth": ("truth", 1e3, ".2f"),
    "before_mm": ("before", 1.0, ".2f"),
    "after_mm": ("after", 1.0, ".2f"),
    "standard_error_mm": ("s.e.", 1.0, ".2f"),
    "bias": ("bias", 1e3, "+.3f"),
    "standard_error_ratio": ("ratio", 1.0, ".3f"),
    "coverage95": ("95 %", 1.0, ".3f"),
}


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
