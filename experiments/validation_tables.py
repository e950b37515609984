"""A validation as tables and sentences."""

from __future__ import annotations

from typing import Any

from tulip_testbed.base.table import Table
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    mass_line,
    models,
    parameter_table,
    read_reported,
)
from tulip_testbed.experiments.run_summary import balance_line, ordinary_line, sag_line, usable_postures
from tulip_testbed.experiments.validate import Validation


def validation_report(result: Validation, document: dict[str, Any]) -> list[Table | str]:
    """Return the tables and sentences of a validation; the verdict is not among them.

    Args:
        document: the validation's report as JSON.
    """
    run, parameters = result.run, result.identification.parameters
    robot, angles = run.laboratory.robot, run.measurements.joint_angles
    parts: list[Table | str] = []
    for model in models(robot):
        pairs = document[model]["correlations"]
        parts += [
            parameter_table(model, document[model], parameters, read_reported(robot)),
            correlation_table(model, pairs, parameters, angles) if pairs else NO_CORRELATION,
            "",
        ]
    if result.ordinary is not None:
        parts.append(ordinary_line(result.ordinary))
    mass = document["total_mass"]
    parts += [LEGEND, *usable_postures(run, robot.settings.get("paper", {}))]
    parts.append(mass_line(mass["estimate"], mass["standard_error"], mass["truth"]))
    if document["books"] is not None:
        parts += [sag_line(run.truth), balance_line(document["books"])]
    return [*parts, "", result.table()]
