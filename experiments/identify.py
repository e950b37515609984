"""Identify a robot from measurements: the full model and the simplified one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.removal import without
from tulip_testbed.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    common_support,
    simplified_numbers,
)
from tulip_testbed.identification.center_of_pressure import total_mass
from tulip_testbed.identification.estimators import DEFAULT, Estimate, estimate_by
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.regressor import check_robot, regression
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.robot import Robot


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
