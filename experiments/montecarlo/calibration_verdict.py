"""The verdict: is the estimator right about its own errors, as far as these runs can tell?

Every check holds a quantity of all parameters against bounds and asks two questions.

It *fails* when the interval of any parameter lies wholly beyond a bound. The intervals hold for all
parameters and checks at once (Bonferroni), so an estimator inside of all bounds is failed with a probability
of at most `LEVEL`. A pass alone is no proof: few runs fail nothing.

It is *shown* when the intervals of all parameters lie wholly inside of the bounds (two one-sided tests,
Schuirmann 1987). All of them have to, so each may have the level by itself (intersection-union, Berger 1982):
an estimator with any parameter beyond a bound is shown to be right with a probability of at most `LEVEL`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tulip_testbed.experiments.montecarlo.intervals import (
    Estimates,
    relative_bias,
    share,
    standard_error_ratio,
)
from tulip_testbed.experiments.montecarlo.summary import LEVELS, WHOLE_LEVEL, Calibration, Summary
from tulip_testbed.experiments.validate import NEGLIGIBLE
from tulip_testbed.identification.distributions import f_ppf, f_sf

LEVEL = 0.01
BIAS = (-0.1, 0.1)  # of the standard error
RATIO = (0.9, 1.1)
COVERAGE = (0.93, 0.97)  # of 95 % intervals
# Runs that could not be identified are missing from all counts: so many move a coverage by a twentieth of
# the room that its bounds leave.
MOST_FAILED = 0.001


@dataclass(frozen=True)
class CalibrationCheck:
    """One line of the verdict.

    Attributes:
        result: "pass", "fail" or "not evaluated".
        shown: whether the runs suffice to show it, if it passes.
        number: the parameter that lies furthest out; None: no single parameter.
        value, interval: its own, at the confidence of all checks together. bounds: low and high.
        beyond: all parameters whose interval lies wholly beyond a bound.
        source: where the bounds come from, or why the check was not evaluated.
    """

    name: str
    result: str
    shown: bool
    number: int | None
    value: float | None
    interval: tuple[float, float] | None
    bounds: tuple[float, float] | None
    beyond: tuple[int, ...]
    source: str


def checks(summary: Summary) -> list[CalibrationCheck]:
    """All checks of a summary."""
    found = [_failed_runs(summary.runs - summary.count, summary.runs)]
    judged = [name for name in summary.models if summary.dropped_truth[name] <= NEGLIGIBLE]
    family = sum(3 * len(summary.models[name].numbers) + 1 for name in judged)
    for name, model in summary.models.items():
        if summary.count < 2:
            found.append(_skipped(f"{name} model", f"{summary.count} runs identified, at least 2 needed"))
        elif name not in judged:
            found.append(
                _skipped(f"{name} model", "the true robot is outside this model: its bias is no error")
            )
        else:
            dof = summary.spreads[f"{name}.residual_dof"].mean
            found += _model_checks(name, model, summary.count, 1 - LEVEL / family, dof)
    return found


def verdict(found: list[CalibrationCheck]) -> str:
    """ "fail" if any check fails, else "pass"."""
    return "fail" if any(check.result == "fail" for check in found) else "pass"


def shown(found: list[CalibrationCheck]) -> bool:
    """Whether the runs suffice to show every check that was evaluated."""
    _, *of_models = [check for check in found if check.result != "not evaluated"]
    return bool(of_models) and all(check.shown for check in found if check.result != "not evaluated")


def whole_bounds(size: int, dof: float) -> tuple[float, float]:
    """Shares of runs beyond the 95 % point of F(size, dof) if all s.e. were off by the factors `RATIO`."""
    limit = f_ppf(1 - WHOLE_LEVEL, size, dof)
    low, high = (float(f_sf(limit / ratio**2, size, dof)) for ratio in RATIO)
    return low, high


def _failed_runs(failed: int, runs: int) -> CalibrationCheck:
    share_failed = failed / runs
    low, high = share(np.array([failed]), runs, 1 - 2 * LEVEL).interval[:, 0]
    return CalibrationCheck(
        name="share of runs that could not be identified",
        result="pass" if low <= MOST_FAILED else "fail",
        shown=bool(high <= MOST_FAILED),
        number=None,
        value=share_failed,
        interval=(float(low), float(high)),
        bounds=(0.0, MOST_FAILED),
        beyond=(),
        source="they are missing from all counts",
    )


def _skipped(name: str, source: str) -> CalibrationCheck:
    return CalibrationCheck(name, "not evaluated", False, None, None, None, None, (), source)


def _model_checks(
    name: str, model: Calibration, count: int, confidence: float, dof: float
) -> list[CalibrationCheck]:
    size, source = len(model.numbers), f"interval of {100 * confidence:.4g} %"
    held: list[tuple[str, Callable[[float], Estimates], tuple[float, float]]] = [
        ("bias over s.e.", partial(relative_bias, model, count), BIAS),
        ("empirical over reported s.e.", partial(standard_error_ratio, model, count), RATIO),
        ("coverage of 95 % intervals", partial(share, model.covered[LEVELS.index(0.95)], count), COVERAGE),
    ]
    checks = [_held(f"{name}: {what}", at, confidence, b, model.numbers, source) for what, at, b in held]
    if model.exceeded is not None:
        what = f"{name}: runs whose chi-square / {size} exceeds 95 % of F"
        exceeded = partial(share, np.array([model.exceeded]), count)
        source += f"; bounds: all s.e. off by the factors {RATIO[0]:g} and {RATIO[1]:g}"
        checks.append(_held(what, exceeded, confidence, whole_bounds(size, dof), None, source))
    return checks


def _held(
    name: str,
    estimate: Callable[[float], Estimates],
    confidence: float,
    bounds: tuple[float, float],
    numbers: np.ndarray | None,
    source: str,
) -> CalibrationCheck:
    """Hold intervals against bounds; reports the parameter that lies furthest out."""
    found, alone = estimate(confidence), estimate(1 - 2 * LEVEL).interval
    (low, high), (least, most) = found.interval, bounds
    beyond = np.maximum(found.value - most, least - found.value)
    worst = int(np.argmax(np.where(np.isnan(beyond), np.inf, beyond)))
    out = ~((low <= most) & (high >= least))  # and where there is no number at all
    return CalibrationCheck(
        name=name,
        result="fail" if out.any() else "pass",
        shown=bool(((alone[0] >= least) & (alone[1] <= most)).all()),
        number=None if numbers is None else int(numbers[worst]),
        value=float(found.value[worst]),
        interval=(float(low[worst]), float(high[worst])),
        bounds=bounds,
        beyond=() if numbers is None else tuple(numbers[out].tolist()),
        source=source,
    )
