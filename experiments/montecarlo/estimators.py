"""Which estimates, with which covariance, a Monte Carlo puts to the test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.validate import identify
from identification.estimators import Estimate
from sim.measurements import Measurements
from sim.model import Robot

DEFAULT_ESTIMATOR = "clustered"
ESTIMATORS = {
    "least-squares": "least squares (eq. 8), errors taken for independent (eq. 14)",
    "clustered": "least squares (eq. 8), standard errors with the placements' common errors",
}


@dataclass(frozen=True)
class Fit:
    """One model's estimate and the covariance that it reports.

    Attributes:
        numbers: of the parameters, (p,).
        value: (p,) [m].
        covariance: (p, p) [m2].
        dof: of each parameter's t interval, (p,).
        residual: (2m,) [m].
        residual_dof: of the residual's variance.
        sigma: eq. 14 [m].
        condition_number: of the regressor.
    """

    numbers: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    dof: np.ndarray
    residual: np.ndarray
    residual_dof: float
    sigma: float
    condition_number: float


@dataclass(frozen=True)
class Fits:
    """Both models' fits by name, and the total mass with its standard error [kg] from so many postures."""

    postures: int
    models: dict[str, Fit]
    mass: tuple[float, float]


def fit(measurements: Measurements, robot: Robot, estimator: str) -> Fits:
    """Identify a robot with one of `ESTIMATORS`.

    Raises:
        InputError: the measurements do not suffice.
    """
    found = identify(measurements, robot)
    models = {"full": found.full, "simplified": found.simplified}
    fits = {name: _fit(estimate, estimator) for name, estimate in models.items()}
    return Fits(len(measurements), fits, found.mass)


def _fit(estimate: Estimate, estimator: str) -> Fit:
    clustered = estimator == "clustered"
    return Fit(
        numbers=estimate.numbers,
        value=estimate.value,
        covariance=estimate.clustered_covariance if clustered else estimate.covariance,
        dof=np.full(len(estimate.value), float(estimate.dof)),
        residual=estimate.residual,
        residual_dof=float(estimate.dof),
        sigma=estimate.sigma,
        condition_number=estimate.condition_number,
    )
