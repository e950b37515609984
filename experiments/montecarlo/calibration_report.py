"""The report of a Monte Carlo as one JSON document [m, kg; keys that end in _mm in mm]."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tulip_testbed.experiments.montecarlo.calibration_verdict import checks, shown, verdict
from tulip_testbed.experiments.montecarlo.intervals import mc_error, share, standard_error_ratio
from tulip_testbed.experiments.montecarlo.run_columns import Layout
from tulip_testbed.experiments.montecarlo.summary import LEVELS, QUANTILES, Calibration, Spread, Summary

CONFIDENCE = 0.95  # of the intervals beside every single figure; the verdict's are wider


def report(summary: Summary, layout: Layout, estimator: str) -> dict[str, Any]:
    """Everything that the runs say; the same bits for the same runs."""
    found = checks(summary)
    models = {
        model: {
            "parameters": parameter_rows(calibration, summary.count, layout.names),
            "beyond_95": summary_share(calibration.exceeded, summary.count),
            **model_spreads(summary.spreads, model),
        }
        for model, calibration in summary.models.items()
    }
    full = models["full"]
    correlations = {
        f"{a},{b}": spread_document(summary.spreads[f"full.correlation.{a}.{b}"]) for a, b in layout.pairs
    }
    (mass,) = parameter_rows(summary.mass, summary.count, ())
    return {
        "runs": summary.runs,
        "estimator": estimator,
        **full,
        "correlations": correlations,
        "simplified": models.get("simplified", {"parameters": []}),
        "total_mass": {key: value for key, value in mass.items() if key not in ("number", "name")},
        "rows": spread_document(summary.spreads["rows"]),
        "dropped": spread_document(summary.spreads["dropped"]),
        "identified": summary.count,
        "failures": summary.failures,
        "checks": [dataclasses.asdict(check) for check in found],
        "verdict": verdict(found),
        "shown": shown(found),
    }


def parameter_rows(found: Calibration, count: int, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """One object a parameter; intervals of `CONFIDENCE`."""
    if count == 0:
        return [_row(number, names) for number in found.numbers.tolist()]
    ratio = standard_error_ratio(found, count, CONFIDENCE)
    coverage = [share(covered, count, CONFIDENCE) for covered in found.covered]
    error = mc_error(found, count)
    rows = []
    for k, number in enumerate(found.numbers.tolist()):
        row = _row(number, names) | {
            "bias": float(found.bias[k]),
            "bias_mc_error": float(error[k]),
            "standard_error": float(found.standard_error[k]),
            "empirical_standard_error": float(found.sd[k]),
            "standard_error_ratio": float(ratio.value[k]),
            "standard_error_ratio_interval": ratio.interval[:, k].tolist(),
        }
        for level, held in zip(LEVELS, coverage, strict=True):
            row[f"coverage{100 * level:.0f}"] = float(held.value[k])
            row[f"coverage{100 * level:.0f}_interval"] = held.interval[:, k].tolist()
        rows.append(row)
    return rows


def _row(number: int, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        "number": number,
        "name": names[number - 1] if names else None,
        "bias": None,
        "bias_mc_error": None,
        "standard_error_ratio": None,
        "coverage95": None,
    }


def summary_share(counted: int | None, count: int) -> dict[str, Any] | None:
    """Share of runs with its interval, or None."""
    if counted is None or count == 0:
        return None
    found = share(np.array([counted]), count, CONFIDENCE)
    return {"share": float(found.value[0]), "interval": found.interval[:, 0].tolist()}


def model_spreads(spreads: dict[str, Spread], model: str) -> dict[str, Any]:
    """Distributions of a model's condition number, residual statistics and chi-square."""
    residual = ("sigma", "residual_mean", "residual_sd", "residual_max")
    return {
        "condition_number": spread_document(spreads[f"{model}.condition_number"]),
        **{f"{name}_mm": spread_document(spreads[f"{model}.{name}"], 1e3) for name in residual},
        "chi_square": spread_document(spreads[f"{model}.chi_square"]),
    }


def spread_document(found: Spread, scale: float = 1.0) -> dict[str, float]:
    quantiles = {
        f"quantile{100 * level:02.0f}": scale * value
        for level, value in zip(QUANTILES, found.quantiles, strict=True)
    }
    return {
        "mean": scale * found.mean,
        "sd": scale * found.sd,
        "min": scale * found.least,
        "max": scale * found.most,
    } | quantiles
