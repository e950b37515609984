"""Measure the coverage of the estimators by Monte Carlo (docs/studies/coverage.md; hours, resumable).

Exact laboratories, in statics; `tulip montecarlo` makes the table of ordinary ones.
"""

from collections.abc import Iterator

import numpy as np

import tulip_testbed as tt
from studies.runner import Settings, header, row
from tulip_testbed.experiments.montecarlo.coverage import ParameterCoverage
from tulip_testbed.identification.estimators import MIXED_MODEL

SETTINGS = Settings(seed=401)
PRESETS = ("wii", "force-plate")
ARMS = [
    (preset, name, estimator, runs)
    for name, estimator, runs in (("default", MIXED_MODEL, 5000), ("least squares", "least-squares", 2000))
    for preset in PRESETS
]


def extremes(rows: list[ParameterCoverage]) -> list[str]:
    """Return the largest bias over s.e. and the ranges of the ratio and of the coverage [%]."""
    ratio = np.array([row.standard_error_ratio for row in rows])
    coverage = 100 * np.array([row.coverage95 for row in rows])
    bias = np.array([row.bias / row.standard_error for row in rows])
    return [
        f"{bias[np.abs(bias).argmax()]:+.3f}",
        f"{ratio.min():.3f} to {ratio.max():.3f}",
        f"{coverage.min():.1f} to {coverage.max():.1f}",
    ]


def study(settings: Settings) -> Iterator[str]:
    """Yield a row an arm and model, with ranges over all parameters."""
    yield header("arm", "runs", "model", "worst bias / s.e.", "s.d. / s.e.", "95 % coverage", "verdict")
    for k, (preset, name, estimator, runs) in enumerate(ARMS):
        result = tt.monte_carlo(
            tt.Laboratory(sensors=preset),
            tt.plans.random,
            runs=settings.count(runs),
            seed=settings.seed + k,
            estimator=estimator,
            workers=settings.workers,
            out=settings.folder("montecarlo") / f"{preset}-{name.replace(' ', '-')}",
            imperfections=0,
        )
        yield row(f"{preset}, {name}", result.runs, "full", *extremes(result.parameters), result.verdict)
        yield row(f"{preset}, {name}", result.runs, "simplified", *extremes(result.simplified.parameters), "")
