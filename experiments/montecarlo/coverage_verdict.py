"""The verdict: is the estimator right about its own errors, as far as these runs can tell?

Every check holds a quantity of all parameters against bounds and asks two questions.

It *fails* when the interval of any parameter lies wholly beyond a bound. The intervals hold for all
parameters and checks at once (Bonferroni), so an estimator inside of all bounds is failed with a probability
of at most `LEVEL`. A pass alone is no proof: few runs fail nothing.

It is *shown* when the intervals of all parameters lie wholly inside of the bounds (two one-sided tests,
Schuirmann 1987). All of them have to, so each may have the level by itself (intersection-union, Berger 1982):
an estimator with any parameter beyond a bound is shown to be right with a probability of at most `LEVEL`.

The errors that are judged are those that are left if the imperfections which the data do not show were known.
Their part of a standard error is what their prior says; laboratories that are drawn from a prior of our own
can neither confirm nor refute it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.result import Figure
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.montecarlo.coverage import WHOLE_LEVEL, Errors, Estimates, Interval, share
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
class CoverageCheck:
    """One line of the verdict.

    Attributes:
        shown: whether the runs suffice to show it, if it passes.
        number: the parameter that lies furthest out; None: no single parameter.
        value, interval: its own, at the confidence of all checks together. bounds: low and high.
        beyond: all parameters whose interval lies wholly beyond a bound.
        source: where the bounds come from, or why the check was not evaluated.
    """

    name: str
    result: Literal["pass", "fail", "not evaluated"]
    shown: bool = False
    number: int | None = None
    value: Figure = np.nan
    interval: Interval | None = None
    bounds: Interval | None = None
    beyond: tuple[int, ...] = ()
    source: str = ""


def checks(runs: int, models: Mapping[str, Errors], outside: Mapping[str, float]) -> list[CoverageCheck]:
    """Make all checks.

    Args:
        runs: how many were asked for. models: errors in those that could be identified, by model.
        outside: largest true size of a parameter that a model leaves out, by model [m].
    """
    count = models["full"].count
    low, high = share(np.array([runs - count]), runs, 1 - 2 * LEVEL)[1][:, 0].tolist()
    failed = CoverageCheck(
        name="share of runs that could not be identified",
        result="pass" if low <= MOST_FAILED else "fail",
        shown=high <= MOST_FAILED,
        value=(runs - count) / runs,
        interval=[low, high],
        bounds=[0.0, MOST_FAILED],
        source="they are missing from all counts",
    )
    done = [failed]
    judged = [name for name in models if outside[name] <= NEGLIGIBLE]
    family = sum(3 * len(models[name].numbers) + 1 for name in judged)
    for name, errors in models.items():
        reason = "the true robot is outside this model: its bias is no error"
        if count < 2:
            reason = f"{count} runs identified, at least 2 needed"
        if count < 2 or name not in judged:
            done.append(CoverageCheck(f"{name} model", "not evaluated", source=reason))
        else:
            done += _model_checks(name, errors, 1 - LEVEL / family)
    return done


def verdict(done: list[CoverageCheck]) -> Literal["pass", "inconclusive", "fail"]:
    """Return "fail" if any check fails, "pass" if the runs show all of them, or else "inconclusive"."""
    if any(check.result == "fail" for check in done):
        return "fail"
    return "pass" if shown(done) else "inconclusive"


def shown(done: list[CoverageCheck]) -> bool:
    """Return whether the runs suffice to show every check that was evaluated."""
    evaluated = [check for check in done if check.result != "not evaluated"]
    return len(evaluated) > 1 and all(check.shown for check in evaluated)  # the first is of failed runs


def whole_bounds(size: int, dof: float) -> tuple[float, float]:
    """Return the shares of runs beyond the 95 % point of F if all s.e. were off by the factors `RATIO`."""
    limit = f_ppf(1 - WHOLE_LEVEL, size, dof)
    low, high = (float(f_sf(limit / ratio**2, size, dof)) for ratio in RATIO)
    return low, high


def _model_checks(name: str, errors: Errors, confidence: float) -> list[CoverageCheck]:
    count, source = len(errors.numbers), f"interval of {100 * confidence:.4g} %"
    held: list[tuple[str, Callable[[float], Estimates], tuple[float, float]]] = [
        ("bias over s.e.", errors.relative_bias, BIAS),
        ("empirical over reported s.e.", errors.standard_error_ratio, RATIO),
        ("coverage of 95 % intervals", errors.coverage, COVERAGE),
    ]
    done = [_held(f"{name}: {what}", at, confidence, b, errors.numbers, source) for what, at, b in held]
    if errors.exceeded is not None:
        what = f"{name}: runs whose chi-square / {count} exceeds 95 % of F"
        exceeded = partial(share, np.array([errors.exceeded]), errors.count)
        source += f"; bounds: all s.e. off by the factors {RATIO[0]:g} and {RATIO[1]:g}"
        bounds = whole_bounds(count, errors.residual_dof)
        done.append(_held(what, exceeded, confidence, bounds, None, source))
    return done


def _held(
    name: str,
    estimate: Callable[[float], Estimates],
    confidence: float,
    bounds: tuple[float, float],
    numbers: np.ndarray | None,
    source: str,
) -> CoverageCheck:
    """Hold intervals against bounds; reports the parameter that lies furthest out."""
    (value, (low, high)), (_, alone), (least, most) = estimate(confidence), estimate(1 - 2 * LEVEL), bounds
    beyond = np.maximum(value - most, least - value)
    worst = int(np.argmax(np.where(np.isnan(beyond), np.inf, beyond)))
    out = ~((low <= most) & (high >= least))  # and where there is no number at all
    return CoverageCheck(
        name=name,
        result="fail" if out.any() else "pass",
        shown=bool(((alone[0] >= least) & (alone[1] <= most)).all()),
        number=None if numbers is None else int(numbers[worst]),
        value=float(value[worst]),
        interval=[float(low[worst]), float(high[worst])],
        bounds=list(bounds),
        beyond=() if numbers is None else tuple(numbers[out].tolist()),
        source=source,
    )


def coverage_check_table(checks: list[CoverageCheck]) -> Table:
    figures = ("worst no.", "", "d"), ("value", "", ".4f"), ("interval", "", ".4f"), ("bounds", "", ".2g")
    extra = (Column(name, extra=True) for name in ("beyond, no.", "where the bounds come from"))
    heads, rows = ("check", "result", *figures, *extra), []
    for check in checks:
        result = check.result if check.shown or check.result != "pass" else "inconclusive"
        figures = (check.number, check.value, check.interval, check.bounds, check.beyond)
        rows.append([check.name, Cell(result, result), *figures, check.source])
    note = (
        f"Bounds: bias within {BIAS[1]:g} s.e., found over stated s.e. {RATIO[0]:g} to {RATIO[1]:g}, "
        f"coverage {100 * COVERAGE[0]:g} to {100 * COVERAGE[1]:g} %. Judged are the errors that "
        "are left if imperfections which the data do not show were known. An estimator inside of the bounds "
        f"fails with a probability below {100 * LEVEL:g} %. Pass: the runs show it, by intervals "
        "wholly inside of the bounds; inconclusive: some still reach beyond them."
    )
    return Table("Checks", heads, rows, note)
