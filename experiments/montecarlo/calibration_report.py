"""The report of a Monte Carlo as one JSON document [m, kg; keys that end in _mm in mm]."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from tulip_testbed.base.document import Document, Figure
from tulip_testbed.base.table_files import finite
from tulip_testbed.experiments.montecarlo.calibration_verdict import checks, shown, verdict
from tulip_testbed.experiments.montecarlo.intervals import mc_error, share, standard_error_ratio
from tulip_testbed.experiments.montecarlo.run_columns import Layout
from tulip_testbed.experiments.montecarlo.summary import LEVELS, QUANTILES, Calibration, Spread, Summary

CONFIDENCE = 0.95  # of the intervals beside every single figure; the verdict's are wider
Interval = Annotated[list[Figure], Field(min_length=2, max_length=2)]


class MassCalibration(Document):
    """Errors against stated standard errors; null where the runs are too few, no intervals without a run."""

    bias: Figure
    bias_mc_error: Figure
    standard_error_ratio: Figure
    coverage95: Figure
    standard_error: Figure = None
    empirical_standard_error: Figure = None
    standard_error_ratio_interval: Interval | None = None
    coverage50: Figure = None
    coverage50_interval: Interval | None = None
    coverage90: Figure = None
    coverage90_interval: Interval | None = None
    coverage95_interval: Interval | None = None


class _Numbered(Document):
    number: int
    name: str | None


class CalibrationRow(MassCalibration, _Numbered):  # the keys come in the reverse order of the bases
    """Errors of a parameter."""


class Share(Document):
    """A share of the runs with its interval."""

    share: float
    interval: Interval


class Distribution(Document):
    """Distribution of a quantity over the runs."""

    mean: Figure
    sd: Figure
    min: Figure
    max: Figure
    quantile05: Figure
    quantile50: Figure
    quantile95: Figure


class ModelCalibration(Document):
    """The summary of all runs for a model; a robot without a simplified model has no rows of it."""

    parameters: list[CalibrationRow]
    beyond_95: Share | None = None
    condition_number: Distribution | None = None
    sigma_mm: Distribution | None = None
    residual_mean_mm: Distribution | None = None
    residual_sd_mm: Distribution | None = None
    residual_max_mm: Distribution | None = None
    chi_square: Distribution | None = None


class CalibrationCheckRow(Document):
    """A line of the verdict, see `CalibrationCheck`."""

    name: str
    result: Literal["pass", "fail", "not evaluated"]
    shown: bool
    number: int | None
    value: Figure
    interval: Interval | None
    bounds: Interval | None
    beyond: list[int]
    source: str


class _Runs(Document):
    runs: int
    estimator: str
    imperfections: float


class CalibrationReport(ModelCalibration, _Runs):  # the keys come in the reverse order of the bases
    """report.json of a Monte Carlo; the full model's keys are the report's own.

    imperfections: their scale in every run's laboratory; 0: it is exact.
    """

    correlations: dict[str, Distribution]
    simplified: ModelCalibration
    total_mass: MassCalibration
    rows: Distribution
    dropped: Distribution
    identified: int
    failures: dict[str, int]
    checks: list[CalibrationCheckRow]
    verdict: Literal["pass", "fail"]
    shown: bool

    @property
    def conclusive(self) -> bool:
        """Whether the runs settle the verdict: a check failed, or there are enough to show that all hold."""
        return self.shown or self.verdict == "fail"

    @property
    def models(self) -> dict[str, ModelCalibration]:
        """The models that the robot has, by name."""
        return {"full": self} | ({"simplified": self.simplified} if self.simplified.parameters else {})


def report(summary: Summary, layout: Layout, estimator: str, imperfections: float) -> CalibrationReport:
    """Report what the runs say; the same bits for the same runs.

    Args:
        estimator, imperfections: see `Settings`.
    """
    found = checks(summary)
    models = {
        model: {
            "parameters": parameter_rows(calibration, summary.count, layout.names),
            "beyond_95": summary_share(calibration.exceeded, summary.count),
            **model_spreads(summary.spreads, model),
        }
        for model, calibration in summary.models.items()
    }
    correlations = {
        f"{a},{b}": spread_document(summary.spreads[f"full.correlation.{a}.{b}"]) for a, b in layout.pairs
    }
    (mass,) = parameter_rows(summary.mass, summary.count, ())
    content = {
        "runs": summary.runs,
        "estimator": estimator,
        "imperfections": float(imperfections),
        **models["full"],
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
    return CalibrationReport.model_validate(finite(content))


def parameter_rows(found: Calibration, count: int, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return one object per parameter; intervals of `CONFIDENCE`."""
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
