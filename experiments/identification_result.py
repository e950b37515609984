"""The result of an identification: parameters by name, tables, a JSON document."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, computed_field

from tulip_testbed.base.errors import InputError, look_up, shortened
from tulip_testbed.base.result import RESULT_FILE, Array, Given, InMemory, Kept, Result
from tulip_testbed.base.table import Table
from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING, SUMMARY
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.effects.instance import EffectInstance, check_instances
from tulip_testbed.effects.removal import without
from tulip_testbed.experiments.correlations import (
    Correlations,
    correlation_table,
    parameter_index,
)
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR
from tulip_testbed.experiments.family_tables import calibration_report, first_to_improve
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    NOT_AT_REST,
    ConstantError,
    cad_line,
    known_sums,
    mass_line,
    models,
    parameter_table,
    standard_table,
    usable_line,
    weak_directions,
)
from tulip_testbed.experiments.run_file import MEASUREMENT_FOLDER
from tulip_testbed.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    common_support,
    simplified_numbers,
    standard_parameters,
)
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.identification.estimators import ESTIMATORS as OF_REGRESSION
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.rank import describe_combinations, labels
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, correlations
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.joined import read_written, write_experiments
from tulip_testbed.sim.robot import Robot

MODELS = ("full", "simplified")
EXPERIMENTS = Kept(MEASUREMENT_FOLDER, write_experiments, lambda folder, robot: read_written(folder))
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
class Identification(Result, Mapping[str, IdentifiedParameter]):
    """The estimates of both models from one set of measurements; prints as Table II of the paper.

    `identification["torso.x"]` and `identification[1]` are the same parameter of the full model.

    Attributes:
        robot: the nominal robot. measurements: as they were measured.
        mass: total mass and its standard error [kg].
        estimator: name of the estimator.
        calibration: families and budget of the self-calibrating estimator; None for the others.
        confounded: directions in the space of the full model that the unknown zeros of force-torque sensors
            imitate, (d, p); their parameters are not known separately. d = 0 with other sensors.
        corrections: effects that the measurements were corrected for.
    """

    robot: Given[Robot]
    measurements: Annotated[Measurements, EXPERIMENTS, Field(exclude=True)]
    parameters: InMemory[BaseParameters]
    full: Estimate
    simplified: Estimate
    mass: tuple[float, float]
    estimator: str = DEFAULT_ESTIMATOR
    calibration: SelfCalibration | None = None
    confounded: Array = field(default_factory=lambda: np.zeros((0, 0)))
    corrections: tuple[EffectInstance, ...] = ()

    def placed_in(self, folder: Path) -> Self:
        found = self.placed(self.robot, self.measurements, str(folder))
        try:
            found.tables()
        except InputError:
            raise
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
            raise InputError(
                f"{folder / RESULT_FILE}: found values that do not fit together ({shortened(error)}), "
                "expected the file as it was written"
            ) from error
        return found

    def placed(self, robot: Robot, measurements: Measurements, where: str, key: str = "") -> Self:
        """Return what was read together with robot and measurements; what does not fit them is refused."""
        check_instances(self.corrections, robot, f"{where}: key '{key}corrections'")
        parameters = base_parameters(robot, support=common_support(measurements.support))
        if self.corrections:
            _, observed = without(measurements, nominal_robot(robot, parameters.support), self.corrections)
            parameters = replace(parameters, tree=observed.tree)
        kept = {
            "full": range(1, len(parameters.names) + 1),
            "simplified": simplified_numbers(robot, parameters),
        }
        for model, numbers in kept.items():
            estimate, count = getattr(self, model), len(numbers)
            shapes = dict.fromkeys(("numbers", "names", "value", "interval_dof"), (count,))
            shapes |= dict.fromkeys(("covariance", "clustered_covariance"), (count, count))
            for name, shape in (shapes | {"residual": (2 * len(measurements),)}).items():
                if (size := np.shape(getattr(estimate, name))) != shape:
                    raise InputError(
                        f"{where}: key '{key}{model}.{name}': found numbers of shape {size}, expected {shape}"
                    )
                if len(shape) == 2 and (least := getattr(estimate, name).diagonal().min()) < 0:
                    raise InputError(f"{where}: key '{key}{model}.{name}': found a variance of {least:g}")
            found = zip(estimate.numbers.tolist(), estimate.names, strict=True)
            for row, (one, number) in enumerate(zip(found, numbers, strict=True)):
                if one != (number, parameters.names[number - 1]):
                    raise InputError(
                        f"{where}: key '{key}{model}.{row}': found parameter {one[0]}, {shortened(one[1])}, "
                        f"expected {number}, {parameters.names[number - 1]}"
                    )
        return replace(self, robot=robot, measurements=measurements, parameters=parameters)

    def __getitem__(self, name: str | int) -> IdentifiedParameter:
        """Return a parameter of the full model by its name or number.

        Raises:
            UnknownNameError: there is none; lists the names that are close and those that are valid.
        """
        full = self.full
        k = parameter_index(name, full.numbers, full.names)
        value, error = float(full.value[k]), float(full.standard_error[k])
        half = float(t_ppf(0.975, full.interval_dof[k])) * error
        ends = (value - half, value + half)
        return IdentifiedParameter(int(full.numbers[k]), full.names[k], value, error, ends)

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

    @computed_field
    @property
    def postures(self) -> int:
        """Return how many rows were measured."""
        return len(self.measurements)

    @computed_field
    @property
    def placements(self) -> int:
        """Return on how many placements."""
        return len(np.unique(self.measurements.placement))

    @computed_field
    @property
    def at_rest(self) -> bool:
        """Return whether the self-calibrating estimator ended within its bounds; always with the others."""
        one = self.calibration
        return one is None or (one.steady and not one.at_bound)

    @computed_field
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
        cad = self.parameters.values(standard_parameters(self.robot.model))
        return parameter_table(model, getattr(self, model), self.parameters, at_rest=self.at_rest, cad=cad)

    def to_frame(self, model: str = "full") -> Any:
        """Return a pandas DataFrame with one row per parameter of a model and its name as the index."""
        return self.table(model).frame().set_index("parameter")

    @property
    def constant(self) -> ConstantError:
        """Return the mean residual of the centre of pressure, which the estimate leaves to the laboratory."""
        residual, mean = self.full.residual.reshape(-1, 2), self._regressor().mean(axis=0)
        error = np.sqrt(np.diag(mean @ self.full.covariance @ mean.T))
        constant = residual.mean(axis=0)
        return ConstantError(constant, 1.96 * error, constant**2 / (residual**2).mean(axis=0))

    def _regressor(self) -> np.ndarray:
        return self.parameters.regressor(self.measurements.joint_angles, self.measurements.support)

    @property
    def usable(self) -> str:
        """Say what of the estimate can be used."""
        matrix = self._regressor()
        variance = np.einsum("mij,jk,mik->mi", matrix, self.full.covariance, matrix)
        sums = len([*known_sums(self.full)])
        known = usable_line(self.full.well_identified, np.sqrt(variance.mean()), sums)
        return known if self.at_rest else NOT_AT_REST

    def answer(self) -> list[Table | str]:
        """Return what is known well, whether that is right, what can be used and what to do next."""
        table = self.table()
        title = f"Full model: parameters that are known better than {WELL_IDENTIFIED:.0f} %"
        rows = [row for row, well in zip(table.rows, self.full.well_identified, strict=True) if well]
        improve = self.calibration if self.at_rest else None
        first = f"; {first_to_improve(improve)}" if improve is not None else ""
        known = [replace(table, title=title, rows=rows), *known_sums(self.full)] if self.at_rest else []
        return [
            *(f"Corrected: {effect.finding}" for effect in self.corrections),
            *known,
            mass_line(*self.mass),
            "",
            "Is it right? measurements alone cannot tell. `validate` tests the estimator on a known robot.",
            self.usable,
            f"Next: `discover` asks whether the model lacks an effect{first}.",
            "`--full` shows all parameters, correlations, ordinary imperfections and the budget of errors.",
        ]

    def tables(self) -> list[Table | str]:
        angles = self.measurements.joint_angles
        parts: list[Table | str] = [f"Corrected: {effect.finding}" for effect in self.corrections]
        for model in models(self.robot):
            estimate = getattr(self, model)
            pairs, weak = estimate.high_correlations, weak_directions(estimate, self.parameters)
            parts += [
                self.table(model),
                correlation_table(model, pairs, self.parameters, angles),
                *([f"Weakly determined: {weak}."] if weak else []),
                "",
            ]
        if self.full.direction_shares is not None and self.full.cad_scales is not None:
            parts.append(cad_line(self.full.direction_shares, self.full.cad_scales))
        if self.full.standard is not None:
            parts.append(standard_table(self.full.standard))
        if self.hidden:
            parts.append(f"Unknown zeros: {self.hidden}.")
        if self.calibration is not None:
            given = (self.full.names, self.measurements.contacts, len(self.measurements))
            parts += calibration_report(self.calibration, *given)
        summary = ESTIMATORS[self.estimator]
        return [*parts, f"Estimator: {self.estimator}. {summary}", LEGEND, mass_line(*self.mass)]
