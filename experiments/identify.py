"""Identify a robot from measurements: the full model and the simplified one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.removal import without
from tulip_testbed.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    common_support,
    simplified_numbers,
)
from tulip_testbed.identification.center_of_pressure import total_mass
from tulip_testbed.identification.estimators import DEFAULT, Estimate, StandardEstimate, estimate_by
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.regressor import check_robot, regression
from tulip_testbed.identification.statistics import (
    high_correlations,
    relative_standard_errors,
    residual_norms,
    standard_errors,
)
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.robot import Robot

HIGH_CORRELATION = 0.85  # the paper's level


@dataclass(frozen=True)
class Identification:
    """Both models' estimates from one set of measurements."""

    parameters: BaseParameters
    full: Estimate
    simplified: Estimate
    mass: tuple[float, float]
    estimator: str = DEFAULT


def identify(
    measurements: Measurements,
    robot: Robot,
    source: str = "measurements",
    estimator: str = DEFAULT,
    parameters: BaseParameters | None = None,
    adopted: Sequence[EffectInstance] = (),
) -> Identification:
    """Full and simplified model.

    Args:
        estimator: a name of `identification.estimators.ESTIMATORS`.
        parameters: the robot's base parameters, if they are at hand: for many identifications of one robot.
        adopted: effects that the measurements are freed of before the regression.

    Raises:
        InputError: the measurements do not fit the robot or do not suffice, or an unknown estimator.
    """
    parameters = parameters or base_parameters(
        robot, support=common_support(measurements.support, f"{source}: postures")
    )
    if adopted:
        check_robot(parameters, measurements, robot, source)
        measurements, observed = without(measurements, nominal_robot(robot, parameters.support), adopted)
        parameters = dataclasses.replace(parameters, tree=observed.tree)
    data = regression(parameters, measurements, robot, source)
    kept = simplified_numbers(robot, parameters)
    full = estimate_by(data, estimator)
    simplified = full if len(kept) == len(data.numbers) else estimate_by(data.keep(kept), estimator)
    return Identification(parameters, full, simplified, total_mass(measurements), estimator)


def model_document(estimate: Estimate, truth: np.ndarray | None) -> dict[str, Any]:
    """One model's part of the JSON report [m, kg; keys that end in _mm in mm]."""
    error = standard_errors(estimate.covariance)
    clustered = standard_errors(estimate.clustered_covariance)
    relative = relative_standard_errors(estimate.value, error)
    norms = residual_norms(estimate.residual)
    rows = []
    for k, number in enumerate(estimate.numbers.tolist()):
        rows.append(
            {
                "number": number,
                "name": estimate.names[k],
                "truth": None if truth is None else float(truth[number - 1]),
                "estimate": float(estimate.value[k]),
                "standard_error": float(error[k]),
                "clustered_standard_error": float(clustered[k]),
                "relative_standard_error": float(relative[k]),
            }
        )
    pairs = high_correlations(estimate.covariance, estimate.numbers, HIGH_CORRELATION)
    standard = estimate.standard
    return {
        "parameters": rows,
        **({} if standard is None else {"links": link_rows(standard), "visible_masses": standard.visible}),
        "sigma_mm": 1e3 * estimate.sigma,
        "placement_sd_mm": [1e3 * sd for sd in estimate.placement_sd],
        "condition_number": estimate.condition_number,
        "residual_mm": {"mean": 1e3 * norms.mean, "sd": 1e3 * norms.sd, "max": 1e3 * norms.max},
        "correlations": [{"a": a, "b": b, "rho": rho} for a, b, rho in pairs],
    }


def link_rows(standard: StandardEstimate) -> list[dict[str, Any]]:
    """Masses and centres of mass of a JSON report [kg, m; keys that end in _share: 0 to 1]."""
    return [
        {
            "link": link,
            "mass": float(standard.mass[k]),
            "mass_standard_error": float(standard.mass_error[k]),
            "mass_data_share": float(standard.mass_share[k]),
            "center": standard.center[k].tolist(),
            "center_standard_error": standard.center_error[k].tolist(),
            "center_data_share": standard.center_share[k].tolist(),
        }
        for k, link in enumerate(standard.links)
    ]
