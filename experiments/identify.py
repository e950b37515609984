"""Identify a robot from measurements: the full model and the simplified one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError, look_up, warn
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.calibration.calibrated_estimate import (
    SELF_CALIBRATING,
    SUMMARY,
    Calibrate,
    calibrated_estimates,
)
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.families import check_tolerances
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.removal import without
from tulip_testbed.experiments.correlations import Correlations, parameter_index
from tulip_testbed.experiments.estimate_report import model_report
from tulip_testbed.experiments.family_tables import calibration_report
from tulip_testbed.experiments.parameter_tables import mass_line, parameter_table
from tulip_testbed.identification.ballast import known_weight
from tulip_testbed.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    common_support,
    simplified_numbers,
)
from tulip_testbed.identification.contact_pressure import contact_pressure
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.identification.estimators import ESTIMATORS as OF_REGRESSION
from tulip_testbed.identification.estimators import Estimate, estimate_by
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.rank import describe_combinations, labels
from tulip_testbed.identification.regressor import check_robot, regression
from tulip_testbed.identification.statistics import (
    correlations,
    standard_errors,
)
from tulip_testbed.identification.zero_confounding import confounded_directions
from tulip_testbed.measurements import Measurements, as_joined
from tulip_testbed.sim.robot import Robot

MODELS = ("full", "simplified")
DEFAULT_ESTIMATOR = SELF_CALIBRATING  # of everything that identifies
CLEARLY = 3.0  # standard errors
MOST_EXTENTS = 2.0  # of the robot's model, by MuJoCo's measure
# What each estimator does, by its name.
ESTIMATORS: dict[str, str] = {name: one.summary for name, one in OF_REGRESSION.items()} | {
    SELF_CALIBRATING: SUMMARY
}


@dataclass(frozen=True)
class IdentifiedParameter:
    """One parameter of the full model.

    Attributes:
        number: from 1, as in the paper. name: LINK.AXIS.
        value, standard_error: [m].
        interval95: low and high end of the 95 % interval [m].
    """

    number: int
    name: str
    value: float
    standard_error: float
    interval95: tuple[float, float]

    def __repr__(self) -> str:
        half = 1e3 * (self.interval95[1] - self.value)
        return f"{self.name} (no. {self.number}): {1e3 * self.value:.2f} ± {half:.2f} mm (95 %)"


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Shown, Mapping[str, IdentifiedParameter]):
    """The estimates of both models from one set of measurements; prints as Table II of the paper.

    `identification["torso.x"]` and `identification[1]` are the same parameter of the full model.

    Attributes:
        mass: total mass and its standard error [kg].
        estimator: name of the estimator.
        calibration: families and budget of the self-calibrating estimator; None for the others.
        confounded: directions in the space of the full model that the unknown zeros of force-torque sensors
            imitate, (d, p); their parameters are not known separately. d = 0 with other sensors.
    """

    parameters: BaseParameters
    full: Estimate
    simplified: Estimate
    mass: tuple[float, float]
    estimator: str = DEFAULT_ESTIMATOR
    calibration: SelfCalibration | None = None
    confounded: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def __getitem__(self, name: str | int) -> IdentifiedParameter:
        """Return a parameter of the full model by its name or number.

        Raises:
            UnknownNameError: there is none; lists the names that are close and those that are valid.
        """
        k = parameter_index(name, self.full.numbers, self.full.names)
        value, error = float(self.full.value[k]), float(standard_errors(self.full.covariance)[k])
        half = float(t_ppf(0.975, self.full.interval_dof[k])) * error
        return IdentifiedParameter(
            int(self.full.numbers[k]), self.full.names[k], value, error, (value - half, value + half)
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self.full.names)

    def __len__(self) -> int:
        return len(self.full.names)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.full.names)

    @property
    def correlations(self) -> Correlations:
        """Return the correlations of the full model's parameters by the estimator's covariance (eq. 15)."""
        return Correlations(self.full.numbers, self.full.names, correlations(self.full.covariance))

    @property
    def at_rest(self) -> bool:
        """Return whether the iteration of the self-calibrating estimator ended; always with the others."""
        return self.calibration is None or self.calibration.steady

    @property
    def hidden(self) -> str:
        """Return which parameters the unknown zeros of force-torque sensors imitate, "" if there are none."""
        if not len(self.confounded):
            return ""
        return describe_combinations(self.confounded, labels(self.full.numbers, self.full.names))

    def table(self, model: str = "full") -> Table:
        """Return the parameters of a model, "full" or "simplified".

        Raises:
            UnknownNameError: another model.
        """
        look_up("model", model, MODELS, "model")
        document = model_report(getattr(self, model), None).plain()
        return parameter_table(model, document, self.parameters, at_rest=self.at_rest)

    def to_frame(self, model: str = "full") -> Any:
        """Return a pandas DataFrame with one row per parameter of a model and its name as the index."""
        return self.table(model).frame().set_index("parameter")

    def parts(self) -> list[Table | str]:
        """Return the parameters of the full model, their high correlations and the total mass.

        The self-calibrating estimator adds its families, members and budget.
        """
        added: list[Table | str] = [f"Unknown zeros: {self.hidden}."] if self.hidden else []
        if self.calibration is not None:
            added += calibration_report(self.calibration, self.full.names)
        return [self.table(), *self.correlations.above().parts(), *added, mass_line(*self.mass)]


def warn_of_unrest(found: Identification, source: str) -> None:
    """Warn of a self-calibration whose linearisations did not come to rest."""
    if found.calibration is not None and not found.at_rest:
        warn(
            f"{source}: the estimate did not come to rest (its last step moved a number by "
            f"{found.calibration.moved:.1f} standard errors): something gross is wrong, or the stated noise; "
            "the preflight and `discover` say more"
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
        estimator: a name of `ESTIMATORS`.
        parameters: the robot's base parameters, if they are at hand: for many identifications of one robot.
        adopted: effects that are removed from the measurements before the regression.
        tolerances: of families of ordinary imperfections, for the self-calibrating estimator, in place of
            those of the measurements and those that fit the sensors [SI]; zero: exact.
        calibrate: how the self-calibrating estimator calibrates.

    Raises:
        InputError: the measurements do not fit the robot or do not suffice, a weighed mass that cannot be
            this robot's, an estimate that no robot of this size and weight has, an unknown estimator, an
            unknown family or an impossible tolerance.
    """
    look_up("estimator", estimator, ESTIMATORS, "estimator")
    measurements = as_joined(measurements)
    check_tolerances(measurements.tolerances, f"{source}: key 'tolerances'")
    check_tolerances(tolerances or {})
    if tolerances and estimator != SELF_CALIBRATING:
        raise InputError(
            f"tolerance: {next(iter(tolerances))}: found with estimator {estimator}, expected "
            f"`estimator={SELF_CALIBRATING}`"
        )
    parameters = parameters or base_parameters(robot, support=common_support(measurements.support))
    observed = None
    if adopted:
        check_robot(parameters, measurements, robot, source)
        measurements, observed = without(measurements, nominal_robot(robot, parameters.support), adopted)
        parameters = dataclasses.replace(parameters, tree=observed.tree)
    data = regression(parameters, measurements, robot, source)
    _check_weighed_mass(measurements, float(robot.model.body_mass.sum()), source)
    kept = simplified_numbers(robot, parameters)
    mass = contact_pressure(measurements, nominal_robot(robot, parameters.support)).mass
    if estimator == SELF_CALIBRATING:
        observed = observed or observe(measurements, nominal_robot(robot, parameters.support))
        free = confounded_directions(observed, data)
        full, simplified, found = calibrated_estimates(observed, data, kept, tolerances, calibrate)
        check_physical(full, found.mass, robot, source)
        return Identification(parameters, full, simplified, found.mass, estimator, found, free)
    if observe(measurements, nominal_robot(robot, parameters.support)).contacts.unsure.any():
        raise InputError(
            f"{source}: found force-torque sensors whose zeros no foot in the air shows well, with estimator "
            f"{estimator}; expected `estimator={SELF_CALIBRATING}`"
        )
    if known_weight(measurements).any():
        raise InputError(
            f"{source}: found a known mass on the robot, with estimator {estimator}; expected "
            f"`estimator={SELF_CALIBRATING}`"
        )
    full = estimate_by(data, estimator)
    simplified = full if len(kept) == len(data.numbers) else estimate_by(data.keep(kept), estimator)
    check_physical(full, mass, robot, source)
    return Identification(parameters, full, simplified, mass, estimator)


def check_physical(found: Estimate, mass: tuple[float, float], robot: Robot, source: str) -> None:
    """Refuse an estimate that no robot of this size and weight has, by more than three standard errors.

    A base parameter is a sum of distances within the robot, each times a share of the total mass.
    """
    call = "`tt.check(measurements)`" if source == "measurements" else f"`tt.check({source!r})`"
    signs = f"wrong signs or units of readings or angles do that; {call} says more"
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


def _check_weighed_mass(measurements: Measurements, mass: float, source: str) -> None:
    """Refuse a weighed mass that is less than half or more than twice that of the model [kg]."""
    weighed = measurements.weighed_mass
    if weighed and not 0.5 < weighed[0] / mass < 2:
        raise InputError(
            f"{source}: key 'weighed_mass': found {weighed[0]:g} kg, expected about {mass:.4g} kg, the mass "
            "of the robot's model"
        )
