"""Repeat an experiment in the static laboratory and identify each run by both models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of, stream_of
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.estimators import DEFAULT, Estimate
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, relative_standard_errors, standard_errors
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.rig import Rig

POSTURES_AT_ONCE = 3000  # solved in one batch
RESAMPLES = 200


@dataclass(frozen=True)
class Model:
    """One model's results, a row a run, shape (runs, p).

    Attributes:
        numbers: of the parameters, (p,).
        value, truth, error: estimate, true value and reported standard error [m].
        sigma: eq. 14, (runs,) [m].
    """

    numbers: np.ndarray
    value: np.ndarray
    truth: np.ndarray
    error: np.ndarray
    sigma: np.ndarray

    @property
    def off(self) -> np.ndarray:
        """Return estimate minus truth, (runs, p) [m]."""
        return self.value - self.truth

    @property
    def well(self) -> np.ndarray:
        """Count the well identified parameters of each run: relative s.e. (eq. 13) below 15 %, (runs,)."""
        return (relative_standard_errors(self.value, self.error) < WELL_IDENTIFIED).sum(axis=1)


@dataclass(frozen=True)
class Repeated:
    """Both models over all runs, the rows that each run measured, and how many runs gave no estimate."""

    full: Model
    simplified: Model
    rows: np.ndarray
    failed: int


def repeat(
    rig: Rig,
    plan: PosturePlan,
    parameters: BaseParameters,
    runs: int,
    seed: int,
    spread: float | None = None,
) -> Repeated:
    """Measure a plan `runs` times with fresh noise and identify it with the default estimator.

    Args:
        spread: of random true robots (`sim.random_robots`); None: the nominal one.

    Raises:
        InputError: a plan that the laboratory cannot stand on, or no run with an estimate.
    """
    hold = source_of(Laboratory(rig.robot, nominal=rig), plan, spread, "statics")
    batch = max(1, POSTURES_AT_ONCE // len(plan))
    found: list[tuple[Outcome, Estimate, Estimate]] = []
    for first in range(0, runs, batch):
        streams = [stream_of(seed, run) for run in range(first, min(first + batch, runs))]
        for outcome in hold(streams):
            if isinstance(outcome, str):
                continue
            try:
                fit = identify(outcome.measurements, rig.robot, estimator=DEFAULT, parameters=parameters)
            except InputError:
                continue
            found.append((outcome, fit.full, fit.simplified))
    if not found:
        raise InputError(f"none of {runs} runs with {len(plan)} postures could be identified")
    truth = np.array([parameters.values(run.truth.standard) for run, _, _ in found])
    return Repeated(
        full=_model([full for _, full, _ in found], truth),
        simplified=_model([simple for _, _, simple in found], truth),
        rows=np.array([len(run.measurements) for run, _, _ in found]),
        failed=runs - len(found),
    )


def _model(estimates: list[Estimate], truth: np.ndarray) -> Model:
    numbers = estimates[0].numbers
    return Model(
        numbers=numbers,
        value=np.array([e.value for e in estimates]),
        truth=truth[:, numbers - 1],
        error=np.array([standard_errors(e.covariance) for e in estimates]),
        sigma=np.array([e.sigma for e in estimates]),
    )


def rms(off: np.ndarray) -> np.ndarray:
    """Compute the root mean square over the runs, (..., runs, p) -> (..., p)."""
    return np.sqrt((off**2).mean(axis=-2))


def monte_carlo_error(statistic: Callable[[np.ndarray], float], off: np.ndarray) -> float:
    """Compute the standard error of a statistic of all runs by resampling the runs (Efron 1979).

    Args:
        statistic: of errors (runs, p).
    """
    rng = np.random.default_rng(len(off))
    draws = rng.integers(len(off), size=(RESAMPLES, len(off)))
    return float(np.std([statistic(off[chosen]) for chosen in draws], ddof=1))
