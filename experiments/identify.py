"""Identify a robot from measurements: the full model and the simplified one."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from tulip_testbed.base.errors import InputError, listed, look_up, warn
from tulip_testbed.base.numbers import number
from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING, Calibrate, calibrated_estimates
from tulip_testbed.calibration.families import check_tolerances
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.calibration.uncertain_corrections import but_for_compliances
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.removal import without
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR
from tulip_testbed.experiments.identification_result import ESTIMATORS, Identification
from tulip_testbed.identification.ballast import known_weight
from tulip_testbed.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    common_support,
    simplified_numbers,
)
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.estimators import Estimate, estimate_by
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.regressor import check_robot, confounded_directions, regression
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import Measurements, as_joined
from tulip_testbed.sim.robot import Robot

CLEARLY = 3.0  # standard errors
MOST_EXTENTS = 2.0  # of the robot's model, by MuJoCo's measure


def warn_of_unrest(found: Identification, source: str) -> None:
    """Warn of a self-calibration that did not come to rest, or in which parts would yield the wrong way."""
    if found.calibration is not None and (absent := found.calibration.absent):
        warn(
            f"{source}: found {listed(absent)} negative beyond doubt, expected none below zero: "
            "something else is wrong; `discover` says more"
        )
    if found.calibration is not None and not found.at_rest:
        wide = found.calibration.at_bound
        bound = f"; as wide as allowed: {listed(wide)}" if wide else ""
        warn(
            f"{source}: the estimate did not come to rest (its last step moved a number by "
            f"{found.calibration.moved:.1f} standard errors{bound}): something gross is wrong, or the "
            "stated noise; the preflight and `discover` say more"
        )


def warn_of_contradiction(found: Identification, source: str, tolerances: Mapping[str, float] | None) -> None:
    """Warn of corrections of other sizes than the measurements show, by more than three standard errors.

    The sizes are estimated together with everything else; those that the data do not determine are left out.
    """
    if found.calibration is None or not found.corrections or not len(found.measurements):
        return
    observed = observe(found.measurements, nominal_robot(found.robot, found.parameters.support))
    if observed.moves or found.calibration.observed.cad is not None:
        return
    try:
        free = self_calibrate(observed, tolerances, found.corrections, found.calibration)
    except (np.linalg.LinAlgError, InputError):
        return
    for given, shown, errors in zip(
        found.corrections, map(FreeEffect, free.effects), free.effect_errors, strict=True
    ):
        parameters = given.effect.parameters_on(given.target)
        every = zip(given.effect.sizes, shown.sizes, errors, shown.prior_sd, strict=True)
        for k, value, error, prior in every:
            if error > prior / 2:
                continue  # the data say too little
            share = 1 - (error / prior) ** 2  # of the data, not of the prior, in the estimate
            value, error = value / share, error / np.sqrt(share)
            off = abs(given.values[k] - value) / error
            if off > CLEARLY:
                told = f"{number(value, '.3g')} ± {number(1.96 * error, '.2g')} {parameters[k].unit}".strip()
                warn(
                    f"{source}: found the correction {given}, but the measurements show {parameters[k].name} "
                    f"{told}, {number(off, '.1f')} standard errors away"
                )


def identify(
    measurements: Measurements,
    robot: Robot,
    source: str = "measurements",
    estimator: str = DEFAULT_ESTIMATOR,
    parameters: BaseParameters | None = None,
    adopted: Sequence[EffectInstance] = (),
    tolerances: Mapping[str, float] | None = None,
    calibrate: Calibrate = self_calibrate,
) -> Identification:
    """Full and simplified model.

    Args:
        parameters: the robot's base parameters, if they are at hand: for many identifications of one robot.
        adopted: effects that are removed from the measurements before the regression; the intervals of their
            sizes count.
        tolerances: see `tulip_testbed.identify`.
        calibrate: how the self-calibrating estimator calibrates.
    """
    look_up("estimator", estimator, ESTIMATORS, "estimator")
    given = measurements = as_joined(measurements)
    check_tolerances(measurements.tolerances, f"{source}: key 'tolerances'")
    check_tolerances(tolerances or {})
    if tolerances and estimator != SELF_CALIBRATING:
        raise InputError(
            f"tolerances: {next(iter(tolerances))}: found with estimator {estimator}, expected "
            f"`estimator={SELF_CALIBRATING}`"
        )
    parameters = parameters or base_parameters(robot, support=common_support(measurements.support))
    nominal = nominal_robot(robot, parameters.support)
    if adopted:
        check_robot(parameters, measurements, robot, source)
        measurements, without_effects = without(measurements, nominal, adopted)
        parameters = dataclasses.replace(parameters, tree=without_effects.tree)
    data = regression(parameters, measurements, robot, source)
    weighed, mass = measurements.weighed_mass, float(robot.model.body_mass.sum())
    if weighed and not 0.5 < weighed[0] / mass < 2:
        raise InputError(
            f"{source}: key 'weighed_mass': found {weighed[0]:g} kg, expected about {mass:.4g} kg, the mass "
            "of the robot's model"
        )
    kept = simplified_numbers(robot, parameters)
    observed = observe(given, nominal) if adopted and estimator == SELF_CALIBRATING else data.observed
    assert observed is not None
    if estimator == SELF_CALIBRATING:
        observed = but_for_compliances(observed, adopted, tolerances)
        free = confounded_directions(observed, data)
        full, simplified, found = calibrated_estimates(observed, data, kept, tolerances, calibrate, adopted)
        mass = found.mass
    elif observed.contacts.unsure.any():
        raise InputError(
            f"{source}: found force-torque sensors whose zeros no foot in the air shows well, with estimator "
            f"{estimator}; expected `estimator={SELF_CALIBRATING}`"
        )
    elif known_weight(measurements).any():
        raise InputError(
            f"{source}: found a known mass on the robot, with estimator {estimator}; expected "
            f"`estimator={SELF_CALIBRATING}`"
        )
    else:
        full, found, free = estimate_by(data, estimator), None, np.zeros((0, 0))
        mass = contact_pressure(observed).mass
        simplified = full if len(kept) == len(data.numbers) else estimate_by(data.keep(kept), estimator)
    check_physical(full, mass, robot, source)
    estimates = (parameters, full, simplified, mass)
    return Identification(robot, given, *estimates, estimator, found, free, tuple(adopted))


def check_physical(found: Estimate, mass: tuple[float, float], robot: Robot, source: str) -> None:
    """Refuse an estimate that no robot of this size and weight has, by more than three standard errors.

    A base parameter is a sum of distances within the robot, each times a share of the total mass.
    """
    signs = "wrong signs or units of readings or angles do that; `check` says more"
    own = float(robot.model.body_mass.sum())
    if not 0.5 * own < mass[0] + CLEARLY * mass[1] or not mass[0] - CLEARLY * mass[1] < 2 * own:
        raise InputError(
            f"{source}: found a total mass of {number(mass[0])} kg by the contact sensors, expected about "
            f"{own:.4g} kg, that of the robot's model; {signs}"
        )
    most = MOST_EXTENTS * float(robot.model.stat.extent)
    beyond = np.abs(found.value) - CLEARLY * standard_errors(found.covariance) - most
    if not (beyond <= 0).all():
        k = int(np.nan_to_num(beyond, nan=np.inf).argmax())
        raise InputError(
            f"{source}: found {found.names[k]} = {number(1e3 * float(found.value[k]))} mm, expected at most "
            f"{1e3 * most:.0f} mm in size for a robot of this size; {signs}"
        )
