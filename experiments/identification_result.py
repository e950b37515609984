"""The result of an identification: parameters by name, tables, a JSON document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tulip_testbed.base.errors import look_up
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING, SUMMARY
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table
from tulip_testbed.experiments.correlations import Correlations, parameter_index
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR
from tulip_testbed.experiments.estimate_report import model_report
from tulip_testbed.experiments.family_tables import calibration_document, calibration_report
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    mass_line,
    models,
    parameter_table,
    standard_table,
    weak_directions,
)
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.identification.estimators import ESTIMATORS as OF_REGRESSION
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.rank import describe_combinations, labels
from tulip_testbed.identification.statistics import correlations, standard_errors
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.robot import Robot

MODELS = ("full", "simplified")
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

    robot: Robot
    measurements: Measurements
    parameters: BaseParameters
    full: Estimate
    simplified: Estimate
    mass: tuple[float, float]
    estimator: str = DEFAULT_ESTIMATOR
    calibration: SelfCalibration | None = None
    confounded: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    corrections: tuple[EffectInstance, ...] = ()

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

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document, which `--json` prints."""
        document: dict[str, Any] = {
            "estimator": self.estimator,
            "corrections": list(map(str, self.corrections)),
            "postures": len(self.measurements),
            "placements": len(np.unique(self.measurements.placement)),
            "condition_number": self.full.condition_number,
            "at_rest": self.at_rest,
            "total_mass": {"estimate": self.mass[0], "standard_error": self.mass[1]},
        }
        for model in MODELS:
            estimate = getattr(self, model)
            weak = weak_directions(estimate, self.parameters)
            document[model] = model_report(estimate, None).plain() | {"hardly_known": weak}
        if self.hidden:
            document["hidden_by_zeros"] = self.hidden
        if self.calibration is not None:
            document |= calibration_document(self.calibration, self.full.names)
        return document

    def tables(self) -> list[Table | str]:
        """Return the parameters of the models, their high correlations and the total mass.

        The self-calibrating estimator adds its families, members and budget.
        """
        document, angles = self.to_json(), self.measurements.joint_angles
        parts: list[Table | str] = [f"Corrected: {effect.finding}" for effect in self.corrections]
        for model in models(self.robot):
            pairs, weak = document[model]["correlations"], document[model]["hardly_known"]
            parts += [
                parameter_table(model, document[model], self.parameters, at_rest=self.at_rest),
                correlation_table(model, pairs, self.parameters, angles) if pairs else NO_CORRELATION,
                *([f"Weakly determined: {weak}."] if weak else []),
                "",
            ]
        if self.full.standard is not None:
            links = document["full"]["links"]
            parts.append(standard_table("full", links, self.full.standard.identifiable))
        if self.hidden:
            parts.append(f"Unknown zeros: {self.hidden}.")
        if self.calibration is not None:
            parts += calibration_report(self.calibration, self.full.names)
        summary = ESTIMATORS[self.estimator]
        return [*parts, f"Estimator: {self.estimator}. {summary}", LEGEND, mass_line(*self.mass)]
