"""Two runs side by side: what was set otherwise and what came out otherwise."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.result import Result, flattened
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.discovery_tables import CHANNEL_NAMES
from tulip_testbed.experiments.identification_result import MODELS
from tulip_testbed.experiments.saved_runs import RunResult
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.identification.estimators import Estimate

NOT_SETTINGS = ("outputs",)  # hashes of results: they differ whenever the results do
SHOWN = {
    "estimate": Column("estimate", "mm", ".2f", 1e3),
    "standard_error": Column("s.e.", "mm", ".2f", 1e3),
    "truth": Column("truth", "mm", ".2f", 1e3),
    "before": Column("before", "mm", ".2f", 1e3),
    "after": Column("after", "mm", ".2f", 1e3),
    "bias": Column("bias", "mm", "+.3f", 1e3),
    "standard_error_ratio": Column("found over stated s.e.", "", ".3f"),
    "coverage95": Column("coverage of 95 %", "%", ".1f", 100),
}
MONTE_CARLO = ("bias", "standard_error", "standard_error_ratio", "coverage95")


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
        runs = zip("AB", self.runs, self.verdict, strict=True)
        settings = [[name, *values] for name, values in self.settings.items()] or [["none", "", ""]]
        a, b = (Column(f"value {run}", format=".4g") for run in "AB")
        values = [[check["name"], *check["value"]] for check in self.checks]
        checks = Table("Gap and evidence", ("quantity", a, b), values)
        if any(result for check in self.checks for result in check["result"]):
            rows = []
            for check in self.checks:
                (first, second), values = (Cell(r, r or "") for r in check["result"]), check["value"]
                rows.append([check["name"], first, values[0], second, values[1]])
            checks = Table("Checks", ("check", "result A", a, "result B", b), rows)
        return [
            *(f"{run}: {name}, verdict {verdict}" for run, name, verdict in runs),
            Table("Settings that differ", ("setting", "A", "B"), settings),
            checks,
            *(model_difference_table(model, rows) for model, rows in self.models.items() if rows),
        ]


def compare(first: RunResult, second: RunResult) -> Comparison:
    models, judged = [_models(first), _models(second)], [_judged(first), _judged(second)]
    _check_alike(first, second, models)
    return Comparison(
        runs=(_name(first), _name(second)),
        verdict=(first.verdict, second.verdict),
        settings=differences(first.document.to_json(), second.document.to_json()),
        checks=[
            {"name": name}
            | {key: [of.get(name, {}).get(key) for of in judged] for key in ("result", "value")}
            for name in {**judged[0], **judged[1]}
        ],
        models={
            model: [
                {"number": a["number"], "name": a["name"]}
                | {name: [a[name], b[name]] for name in a if name in SHOWN}
                for a, b in zip(rows, models[1][model], strict=True)
            ]
            for model, rows in models[0].items()
        },
    )


def differences(first: dict[str, Any], second: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the settings that are not the same in both documents, by name."""
    flat = [flattened({k: v for k, v in d.items() if k not in NOT_SETTINGS}) for d in (first, second)]
    both = {name: [one.get(name) for one in flat] for name in {**flat[0], **flat[1]}}
    return {name: [a, b] for name, (a, b) in both.items() if a != b}


def model_difference_table(model: str, rows: list[dict[str, Any]]) -> Table:
    quantities = [name for name in rows[0] if name not in ("number", "name")]
    of_runs = [replace(SHOWN[q], name=f"{SHOWN[q].name} {run}") for q in quantities for run in "AB"]
    lines = [[row["number"], row["name"], *(v for name in quantities for v in row[name])] for row in rows]
    return Table(f"{model.capitalize()} model", (("no.", "", "d"), "parameter", *of_runs), lines)


def _name(run: RunResult) -> str:
    return "in memory" if run.folder is None else str(run.folder)


def _check_alike(first: RunResult, second: RunResult, models: list[dict[str, list[dict[str, Any]]]]) -> None:
    where = f"{_name(first)}, {_name(second)}: cannot be compared"
    if first.kind != second.kind:
        raise InputError(f"{where}: found a {first.kind} and a {second.kind}, expected two of a kind")
    for model in dict.fromkeys([*models[0], *models[1]]):
        names = [[row["name"] for row in of.get(model, [])] for of in models]
        if names[0] != names[1]:
            raise InputError(
                f"{where}: found {len(names[0])} and {len(names[1])} parameters of the {model} model with "
                "other names, expected the same ones (the same support)"
            )


def _models(run: RunResult) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of parameters of each model, with the quantities that are compared."""
    if isinstance(run, Validation):
        found = {}
        for model in MODELS:
            own: Estimate = getattr(run.identification, model)
            errors, truth = own.standard_error, run.truth[own.numbers - 1]
            found[model] = _rows(own, estimate=own.value, standard_error=errors, truth=truth)
        return found
    if isinstance(run, Discovered):
        before, last = run.before.full, (run.after or run.before).full
        after = last.value if run.after else np.full(len(before.names), None)
        errors = last.clustered_standard_error
        return {"full": _rows(before, before=before.value, after=after, standard_error=errors)}
    document = run.to_json()
    parts = {"full": document["parameters"], "simplified": document["simplified"]["parameters"]}
    return {
        model: [{name: row.get(name) for name in ("number", "name", *MONTE_CARLO)} for row in rows]
        for model, rows in parts.items()
    }


def _rows(model: Estimate, /, **quantities: np.ndarray) -> list[dict[str, Any]]:
    columns = {"number": model.numbers.tolist(), "name": model.names}
    columns |= {name: values.tolist() for name, values in quantities.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _judged(run: RunResult) -> dict[str, dict[str, Any]]:
    """Return a run's checks by name; of a discovery the gap by channel, its explanations and their sizes."""
    if not isinstance(run, Discovered):
        return {check["name"]: check for check in run.to_json()["checks"]}
    sides = {"before": run.heldout.before, "after": run.heldout.after}
    values = {
        f"gap {'all' if channel == 'AFTC' else channel}, {side}": by_channel[channel]
        for channel in CHANNEL_NAMES
        for side, by_channel in sides.items()
        if channel in by_channel
    }
    values |= {f"gap mm, {side}": run.heldout.millimetres[k] for k, side in enumerate(sides)}
    for one in run.explanations:
        effect = one.instance
        name = effect.label if one.gap == 1 else f"{effect.label} (gap {one.gap})"
        values[f"ln BF {name}"] = one.log_bayes_factor
        for parameter, value in zip(effect.effect.parameters, effect.values, strict=True):
            values[f"{name} {parameter.heading}"] = value
    return {name: {"value": value} for name, value in values.items()}
