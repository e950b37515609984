"""The summary of all runs: what their errors were and what the estimator said that they would be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.table_files import Columns
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.moments import histogram, moments, quantiles
from tulip_testbed.experiments.montecarlo.run_columns import SCALARS, Layout, check_identified
from tulip_testbed.identification.distributions import f_ppf, t_ppf

LEVELS = (0.5, 0.9, 0.95)  # of the intervals whose coverage is counted
QUANTILES = (0.05, 0.5, 0.95)
WHOLE_LEVEL = 0.05  # share of runs whose errors together should exceed what is stated


@dataclass(frozen=True)
class Calibration:
    """Errors of p parameters against their stated standard errors.

    Attributes:
        numbers: (p,).
        bias: mean error, (p,) [m].
        sd: of the errors, (p,) [m].
        standard_error: root of the mean reported variance, (p,) [m].
        covered: runs whose interval held the truth, by `LEVELS`, (3, p).
        truth: least and largest true value over the runs, (2, p) [m].
        exceeded: runs whose errors together lie beyond the 1 - `WHOLE_LEVEL` quantile; None: one parameter.
    """

    numbers: np.ndarray
    bias: np.ndarray
    sd: np.ndarray
    standard_error: np.ndarray
    covered: np.ndarray
    truth: np.ndarray
    exceeded: int | None


@dataclass(frozen=True)
class Spread:
    """Distribution of one quantity over the runs; quantiles at `QUANTILES`."""

    mean: float
    sd: float
    least: float
    most: float
    quantiles: tuple[float, ...]


@dataclass(frozen=True)
class Summary:
    """The summary of all runs.

    Attributes:
        runs: how many were asked for; count: how many could be identified.
        failures: reason of every kind of failed run and how many there were.
        models: by name. mass: the total mass as the only parameter of its own "model" [kg].
        spreads: by column.
        dropped_truth: largest true size of a parameter that a model leaves out, by model [m].
    """

    runs: int
    count: int
    failures: dict[str, int]
    models: dict[str, Calibration]
    mass: Calibration
    spreads: dict[str, Spread]
    dropped_truth: dict[str, float]


def summarise(chunks: Chunks, layout: Layout) -> Summary:
    """Go through the results twice, a chunk at a time: memory does not depend on the number of runs.

    Raises:
        InputError: a chunk is missing or damaged.
    """
    spread_names = [*(name for name in layout.columns() if _is_spread(name)), "rows", "dropped"]

    def rows() -> Iterator[np.ndarray]:
        return (_matrix(part, spread_names) for part in _identified(chunks, spread_names))

    found = moments(rows(), len(spread_names))
    counts = histogram(rows(), found)
    at = quantiles(counts, found, QUANTILES) if found.count else np.full((3, len(spread_names)), np.nan)
    spreads = {
        name: Spread(
            float(found.mean[k]),
            float(found.sd[k]),
            float(found.least[k]),
            float(found.most[k]),
            tuple(at[:, k].tolist()),
        )
        for k, name in enumerate(spread_names)
    }
    return Summary(
        runs=chunks.runs,
        count=found.count,
        failures=_failures(chunks),
        models={model: _calibration(chunks, model, numbers) for model, numbers in layout.models.items()},
        mass=_mass(chunks),
        spreads=spreads,
        dropped_truth={
            model: _dropped_truth(chunks, sorted(set(layout.numbers) - set(numbers)))
            for model, numbers in layout.models.items()
        },
    )


def errors_mm(chunks: Chunks, layout: Layout) -> dict[str, np.ndarray]:
    """Return estimate minus truth of every identified run by model, (runs, p) [mm].

    Raises:
        InputError: a chunk is missing or damaged.
    """
    found = {}
    for model, numbers in layout.models.items():
        value, truth = [f"{model}.value.{n}" for n in numbers], [f"truth.{n}" for n in numbers]
        parts = _identified(chunks, [*value, *truth])
        found[model] = 1e3 * np.vstack([_matrix(part, value) - _matrix(part, truth) for part in parts])
    return found


def _is_spread(name: str) -> bool:
    model, what, *_ = [*name.split("."), ""]
    return model in ("full", "simplified") and what in (*SCALARS, "correlation")


def _identified(chunks: Chunks, names: list[str]) -> Iterator[Columns]:
    """Chunks without the failed runs."""
    for index, part in enumerate(chunks.read([*names, "failure"])):
        good = part["failure"] == ""
        identified = {name: values[good] for name, values in part.items()}
        check_identified(chunks.path(index), identified)
        yield identified


def _matrix(part: Columns, names: list[str]) -> np.ndarray:
    return np.column_stack([part[name] for name in names]).astype(float)


def _failures(chunks: Chunks) -> dict[str, int]:
    tally: dict[str, int] = {}
    for part in chunks.read(["failure"]):
        for reason in part["failure"]:
            if reason:
                tally[str(reason)] = tally.get(str(reason), 0) + 1
    return tally


def _calibration(chunks: Chunks, model: str, numbers: tuple[int, ...]) -> Calibration:
    value, error, dof = ([f"{model}.{what}.{n}" for n in numbers] for what in ("value", "se", "dof"))
    truth = [f"truth.{n}" for n in numbers]
    whole = [f"{model}.chi_square", f"{model}.residual_dof"]
    return _calibrated(chunks, np.array(numbers), value, error, dof, truth, whole)


def _mass(chunks: Chunks) -> Calibration:
    return _calibrated(chunks, np.array([0]), ["mass"], ["mass_se"], ["mass_dof"], ["true_mass"], [])


def _calibrated(
    chunks: Chunks,
    numbers: np.ndarray,
    value: list[str],
    error: list[str],
    dof: list[str],
    truth: list[str],
    whole: list[str],
) -> Calibration:
    """From the names of the columns; `whole`: chi-square and degrees of freedom, or nothing."""
    size, covered, exceeded = len(numbers), np.zeros((len(LEVELS), len(numbers)), dtype=np.int64), 0

    def rows() -> Iterator[np.ndarray]:
        """Error, stated variance and truth of every run, (n, 3 p); counts on the way."""
        nonlocal covered, exceeded
        for part in _identified(chunks, [*value, *error, *dof, *truth, *whole]):
            values, errors, free, true = (_matrix(part, names) for names in (value, error, dof, truth))
            off = np.abs(values - true)
            for k, level in enumerate(LEVELS):
                covered[k] += (off <= t_ppf((1 + level) / 2, free) * errors).sum(axis=0)
            if whole:
                # The chi-square over p as F, since the covariance is itself estimated.
                limit = size * f_ppf(1 - WHOLE_LEVEL, size, part[whole[1]])
                exceeded += int((part[whole[0]] > limit).sum())
            yield np.column_stack([values - true, errors**2, true])

    found = moments(rows(), 3 * size)
    bias, variance, _ = np.split(found.mean, 3)
    return Calibration(
        numbers=numbers,
        bias=bias,
        sd=found.sd[:size],
        standard_error=np.sqrt(variance),
        covered=covered,
        truth=np.array([found.least[2 * size :], found.most[2 * size :]]),
        exceeded=exceeded if whole else None,
    )


def _dropped_truth(chunks: Chunks, numbers: list[int]) -> float:
    names, most = [f"truth.{n}" for n in numbers], 0.0
    if names:
        for part in _identified(chunks, names):
            most = max(most, float(np.abs(_matrix(part, names)).max(initial=0.0)))
    return most
