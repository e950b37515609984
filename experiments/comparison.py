"""Two runs side by side: what was set otherwise and what came out otherwise."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from tulip_testbed.base.column import Column
from tulip_testbed.base.document import flattened
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.discovery_record import DiscoveryRecord
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.records import Record
from tulip_testbed.experiments.validation_record import ValidationRecord

NOT_SETTINGS = ("outputs",)  # hashes of results: they differ whenever the results do
SHOWN = {
    "estimate": Column("estimate", "mm", ".2f", 1e3),
    "standard_error": Column("s.e.", "mm", ".2f", 1e3),
    "truth": Column("truth", "mm", ".2f", 1e3),
    "before_mm": Column("before", "mm", ".2f"),
    "after_mm": Column("after", "mm", ".2f"),
    "standard_error_mm": Column("s.e.", "mm", ".2f"),
    "bias": Column("bias", "mm", "+.3f", 1e3),
    "standard_error_ratio": Column("found over stated s.e.", "", ".3f"),
    "coverage95": Column("coverage of 95 %", "%", ".1f", 100),
}
Judged = ValidationRecord | MonteCarlo | DiscoveryRecord
QUANTITIES = {
    "validation": ("estimate", "standard_error", "truth"),
    "Monte Carlo": ("bias", "standard_error", "standard_error_ratio", "coverage95"),
    "discovery": ("before_mm", "after_mm", "standard_error_mm"),
}


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """Two runs side by side; lists hold the first run's value, then the second's.

    Attributes:
        runs: their folders. verdict: of each. settings: those that differ.
        checks: of both; of two discoveries gap and evidence. models: parameters by model.
    """

    runs: tuple[str, str]
    verdict: tuple[str, str]
    settings: dict[str, list[Any]]
    checks: list[dict[str, Any]]
    models: dict[str, list[dict[str, Any]]]

    def tables(self) -> list[Table | str]:
        """Return the verdicts, and what differs."""
        return [
            *(
                f"{run}: {name}, verdict {v}"
                for run, name, v in zip("AB", self.runs, self.verdict, strict=True)
            ),
            settings_difference_table(self.settings),
            check_difference_table(self.checks),
            *(model_difference_table(model, rows) for model, rows in self.models.items() if rows),
        ]


def compare(first: Record, second: Record) -> Comparison:
    """Compare the settings and the results of two runs.

    Raises:
        InputError: runs that cannot be compared; says why.
    """
    _check_alike(first, second)
    both = [_models(first), _models(second)]
    return Comparison(
        runs=(_name(first), _name(second)),
        verdict=(_report(first)["verdict"], _report(second)["verdict"]),
        settings=differences(first.document.plain(), second.document.plain()),
        checks=_checks(_judged(first), _judged(second)),
        models={
            model: [
                {"number": a["number"], "name": a["name"]}
                | {name: [a.get(name), b.get(name)] for name in QUANTITIES[first.kind]}
                for a, b in zip(both[0][model], both[1][model], strict=True)
            ]
            for model in both[0]
        },
    )


def differences(first: dict[str, Any], second: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the settings that are not the same in both documents, by name."""
    flat = [flattened({k: v for k, v in d.items() if k not in NOT_SETTINGS}) for d in (first, second)]
    names = dict.fromkeys([*flat[0], *flat[1]])
    return {
        name: [flat[0].get(name), flat[1].get(name)]
        for name in names
        if flat[0].get(name) != flat[1].get(name)
    }


def settings_difference_table(settings: dict[str, list[Any]]) -> Table:
    """Return the settings that differ."""
    rows = [[name, *values] for name, values in settings.items()]
    return Table(
        "Settings that differ", (Column("setting"), Column("A"), Column("B")), rows or [["none", "", ""]]
    )


def check_difference_table(checks: list[dict[str, Any]]) -> Table:
    """Return the checks of both runs; of two discoveries the gap and the evidence."""
    judged = any(result for check in checks for result in check["result"])
    value = [Column(f"value {run}", format=".4g") for run in "AB"]
    if not judged:
        columns = (Column("quantity"), *value)
        return Table("Gap and evidence", columns, [[c["name"], *c["value"]] for c in checks])
    columns = (Column("check"), Column("result A"), value[0], Column("result B"), value[1])
    rows = [
        [
            check["name"],
            *(
                x
                for r, v in zip(check["result"], check["value"], strict=True)
                for x in (Cell(r, mark=r or ""), v)
            ),
        ]
        for check in checks
    ]
    return Table("Checks", columns, rows)


def model_difference_table(model: str, rows: list[dict[str, Any]]) -> Table:
    """Return the parameters of a model in both runs."""
    quantities = [name for name in rows[0] if name not in ("number", "name")]
    columns = (
        Column("no.", format="d"),
        Column("parameter"),
        *(
            dataclasses.replace(SHOWN[name], name=f"{SHOWN[name].name} {run}")
            for name in quantities
            for run in "AB"
        ),
    )
    lines = [[row["number"], row["name"], *(v for name in quantities for v in row[name])] for row in rows]
    return Table(f"{model.capitalize()} model", columns, lines)


def _name(run: Record) -> str:
    return "in memory" if run.folder is None else str(run.folder)


def _report(run: Judged) -> dict[str, Any]:
    return run.to_json() if isinstance(run, MonteCarlo) else run.report.plain()


def _check_alike(first: Judged, second: Judged) -> None:
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


def _models(run: Judged) -> dict[str, list[dict[str, Any]]]:
    report = _report(run)
    if isinstance(run, DiscoveryRecord):
        return {"full": report["parameters"]}
    full = report if isinstance(run, MonteCarlo) else report["full"]
    return {"full": full["parameters"], "simplified": report["simplified"]["parameters"]}


def _judged(run: Judged) -> list[dict[str, Any]]:
    """Return a run's checks; of a discovery the gap by channel, its explanations and their sizes."""
    if not isinstance(run, DiscoveryRecord):
        return _report(run)["checks"]
    gap = [
        {"name": f"gap {channel}, {side}", "result": None, "value": getattr(ratio, side)}
        for channel, ratio in run.report.gap.items()
        if ratio is not None
        for side in ("before", "after")
    ]
    explained = []
    for found in run.report.candidates:
        name = found.label if found.gap == 1 else f"{found.label} (gap {found.gap})"
        explained.append({"name": f"ln BF {name}", "result": None, "value": found.log_bayes_factor})
        for p in found.parameters:
            unit = f" [{p.unit}]" if p.unit else ""
            explained.append({"name": f"{name} {p.name}{unit}", "result": None, "value": p.value})
    return gap + explained


def _checks(first: list[dict[str, Any]], second: list[dict[str, Any]]) -> list[dict[str, Any]]:
    of = [{check["name"]: check for check in checks} for checks in (first, second)]
    return [
        {"name": name}
        | {key: [checks.get(name, {}).get(key) for checks in of] for key in ("result", "value")}
        for name in dict.fromkeys([*of[0], *of[1]])
    ]
