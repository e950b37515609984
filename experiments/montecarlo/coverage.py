"""Errors of estimates over many runs compared with the standard errors that the estimator stated."""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from tulip_testbed.base.column import Column
from tulip_testbed.base.result import Figure
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import Columns
from tulip_testbed.experiments.montecarlo.run_columns import errors_of, matrix
from tulip_testbed.identification.distributions import chi2_ppf, f_ppf, t_ppf

COVERED = 0.95  # level of the intervals whose coverage is counted
WHOLE_LEVEL = 0.05  # share of runs whose errors together should exceed what is stated
CONFIDENCE = 0.95  # of the intervals beside every single figure; the verdict's are wider
LEGEND = (
    "bias: mean error; its s.e.: by the number of runs; stated s.e.: by the estimator; found s.e.: s.d. of "
    "the errors over the runs; coverage: share of the runs whose 95 % intervals hold the truth. "
    "Intervals are of 95 % for every single number; those of the checks are wider, since they hold for all "
    "at once."
)
Interval = Annotated[list[Figure], Field(min_length=2, max_length=2)]


@dataclass(frozen=True)
class Coverage:
    """Errors of a quantity against its stated standard errors [m; kg]; NaN where the runs are too few."""

    bias: Figure
    bias_mc_error: Figure
    standard_error: Figure
    empirical_standard_error: Figure
    standard_error_ratio: Figure
    standard_error_ratio_interval: Interval
    coverage95: Figure
    coverage95_interval: Interval


@dataclass(frozen=True)
class ParameterCoverage(Coverage):
    """Errors of a base parameter; number: from 1."""

    number: int
    name: str


@dataclass(frozen=True)
class Share:
    """A share of the runs with its interval."""

    share: float
    interval: Interval


@dataclass(frozen=True, kw_only=True)
class ModelCoverage:
    """The errors of a model's parameters; a robot without a simplified model has no rows of it.

    Attributes:
        beyond_95: share of the runs whose errors together exceed 95 % of F; None: no run, or one parameter.
    """

    parameters: list[ParameterCoverage]
    beyond_95: Share | None = None


# Estimates of a quantity for p parameters, (p,), and their intervals, (2, p).
Estimates = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Errors:
    """Errors of p parameters over the identified runs, against their stated standard errors.

    Attributes:
        numbers: (p,). count: of the runs.
        bias: mean error, (p,) [m].
        sd: of the errors, (p,) [m].
        standard_error: root of the mean reported variance, (p,) [m].
        covered: runs whose 95 % interval held the truth, (p,).
        exceeded: runs whose errors together lie beyond the 1 - `WHOLE_LEVEL` quantile; None: one parameter.
        residual_dof: mean degrees of freedom of the residual's variance.
    """

    numbers: np.ndarray
    count: int
    bias: np.ndarray
    sd: np.ndarray
    standard_error: np.ndarray
    covered: np.ndarray
    exceeded: int | None = None
    residual_dof: float = np.nan

    @property
    def mc_error(self) -> np.ndarray:
        """Return the Monte Carlo standard error of the bias, (p,) [m]."""
        return self.sd / np.sqrt(self.count) if self.count else self.sd

    def relative_bias(self, confidence: float) -> Estimates:
        """Return the bias over the standard error, with Student's interval for the mean error."""
        half = t_ppf((1 + confidence) / 2, self.count - 1) * self.mc_error
        bias = np.array([self.bias, self.bias - half, self.bias + half])
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = bias / self.standard_error
        return relative[0], relative[1:]

    def standard_error_ratio(self, confidence: float) -> Estimates:
        """Return the s.d. of the errors over the stated standard error, with the interval of an s.d.

        The interval (chi-square) takes the errors for normal and leaves out the scatter of the reported
        variance's mean, which is far smaller.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.sd / self.standard_error
        tail = (1 - confidence) / 2
        if self.count < 2:
            return ratio, np.full((2, len(ratio)), np.nan)
        factors = np.sqrt((self.count - 1) / chi2_ppf([1 - tail, tail], self.count - 1))
        return ratio, factors[:, None] * ratio

    def coverage(self, confidence: float) -> Estimates:
        """Return the share of the runs whose 95 % interval held the truth."""
        return share(self.covered, self.count, confidence)


def share(counts: np.ndarray, count: int, confidence: float) -> Estimates:
    """Return a share of the runs with the exact binomial interval (Clopper and Pearson 1934)."""
    from statsmodels.stats.proportion import proportion_confint  # half a second to load

    counts = np.asarray(counts)
    if not count:
        return np.full(len(counts), np.nan), np.full((2, len(counts)), np.nan)
    interval = proportion_confint(counts, count, alpha=1 - confidence, method="beta")
    return counts / count, np.array(interval)


def summarise_errors(
    error: np.ndarray, stated: np.ndarray, dof: np.ndarray, numbers: tuple[int, ...] = (0,)
) -> Errors:
    """Summarise errors, (n, p) [m], by stated standard errors and their degrees of freedom, (n, p)."""
    count = len(error)
    none = np.full(error.shape[1], np.nan)
    return Errors(
        numbers=np.array(numbers),
        count=count,
        bias=error.mean(axis=0) if count else none,
        sd=error.std(axis=0, ddof=1) if count > 1 else none,
        standard_error=np.sqrt((stated**2).mean(axis=0)) if count else none,
        covered=(np.abs(error) <= t_ppf((1 + COVERED) / 2, dof) * stated).sum(axis=0),
    )


def model_errors(runs: Columns, model: str, numbers: tuple[int, ...], given: bool = False) -> Errors:
    """Summarise a model's errors, or those `given` the imperfections that the data do not show."""
    value, error = ("given", "given_se") if given else ("value", "se")
    stated, dof = (matrix(runs, [f"{model}.{name}.{n}" for n in numbers]) for name in (error, "dof"))
    errors = summarise_errors(errors_of(runs, model, numbers, value), stated, dof, numbers)
    # The chi-square over p as F, since the covariance is itself estimated.
    below = runs[f"{model}.residual_dof"]
    limit = len(numbers) * f_ppf(1 - WHOLE_LEVEL, len(numbers), below)
    exceeded = int((runs[f"{model}.chi_square"] > limit).sum())
    return replace(errors, exceeded=exceeded, residual_dof=float(below.mean()) if errors.count else np.nan)


def coverage_of(errors: Errors) -> list[tuple[Any, ...]]:
    """Return the figures of every parameter in the order of `Coverage`."""
    ratio, ratio_interval = errors.standard_error_ratio(CONFIDENCE)
    held, held_interval = errors.coverage(CONFIDENCE)
    sizes = (errors.bias, errors.mc_error, errors.standard_error, errors.sd)
    figures = (*sizes, ratio, ratio_interval.T, held, held_interval.T)
    return list(zip(*(figure.tolist() for figure in figures), strict=True))


def model_coverage(errors: Errors, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the fields of `ModelCoverage`, by the names of all base parameters."""
    rows = zip(errors.numbers.tolist(), coverage_of(errors), strict=True)
    beyond = None
    if errors.exceeded is not None and errors.count:
        exceeded, interval = share(np.array([errors.exceeded]), errors.count, CONFIDENCE)
        beyond = Share(float(exceeded[0]), interval[:, 0].tolist())
    parameters = [ParameterCoverage(*row, number=n, name=names[n - 1]) for n, row in rows]
    return {"parameters": parameters, "beyond_95": beyond}


# Columns of the table of a model's parameters, by their names in `ParameterCoverage`.
SHOWN = {
    "number": Column("no.", format="d"),
    "name": Column("parameter"),
    "bias": Column("bias", "mm", "+.3f", 1e3),
    "bias_mc_error": Column("s.e. of bias", "mm", ".3f", 1e3),
    "standard_error": Column("stated s.e.", "mm", ".3f", 1e3),
    "empirical_standard_error": Column("found s.e.", "mm", ".3f", 1e3, extra=True),
    "standard_error_ratio": Column("found over stated", "", ".3f"),
    "standard_error_ratio_interval": Column("its interval", "", ".2f", extra=True),
    "coverage95": Column("coverage of 95 %", "%", ".1f", 100),
    "coverage95_interval": Column("its 95 % interval", "%", ".1f", 100, extra=True),
}


def coverage_table(model: str, rows: list[ParameterCoverage]) -> Table:
    """Return bias, standard errors and coverage of the parameters of the "full" or "simplified" model."""
    lines = [[getattr(row, name) for name in SHOWN] for row in rows]
    return Table(f"{model.capitalize()} model", tuple(SHOWN.values()), lines)
