"""Estimates and stated errors of an estimator, as a Monte Carlo tests them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.identify import identify
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.robot import Robot


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


def fit(
    measurements: Measurements,
    robot: Robot,
    parameters: BaseParameters,
    estimator: str,
    adopted: Sequence[EffectInstance] = (),
) -> Fits:
    """Identify a robot with an estimator of `experiments.identify.ESTIMATORS`.

    Args:
        adopted: effects that are removed from the measurements before.

    Raises:
        InputError: the measurements do not suffice.
    """
    found = identify(measurements, robot, estimator=estimator, parameters=parameters, adopted=adopted)
    models = {"full": found.full, "simplified": found.simplified}
    fits = {name: _fit(estimate) for name, estimate in models.items()}
    return Fits(len(measurements), fits, found.mass)


def _fit(estimate: Estimate) -> Fit:
    return Fit(
        numbers=estimate.numbers,
        value=estimate.value,
        covariance=estimate.covariance,
        dof=estimate.interval_dof,
        residual=estimate.residual,
        residual_dof=float(estimate.dof),
        sigma=estimate.sigma,
        condition_number=estimate.condition_number,
    )
