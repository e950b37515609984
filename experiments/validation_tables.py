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
from tulip_testbed.experiments.run_summary import balance_line, imperfections_line, sag_line, usable_postures
from tulip_testbed.experiments.validate import Validation


def validation_report(result: Validation, document: dict[str, Any]) -> list[Table | str]:
    """Return the tables and sentences of a validation; the verdict is not among them.

    Args:
        document: the validation's report as JSON.
    """
    run, parameters = result.run, result.identification.parameters
    robot, angles = run.laboratory.robot, run.measurements.joint_angles
    parts: list[Table | str] = []
    plain = document["least_squares"] or {}
    where = "least_squares." if plain else ""
    for model in models(robot):
        # Eq. 15 is of least squares: priors of imperfections would hide what the postures do not distinguish.
        pairs = plain.get(model, document[model])["correlations"]
        parts += [
            parameter_table(
                model, document[model], parameters, read_reported(robot), least_squares=plain.get(model)
            ),
            correlation_table(model, pairs, parameters, angles, where) if pairs else NO_CORRELATION,
            "",
        ]
    mass = document["total_mass"]
    parts += [
        LEGEND,
        imperfections_line(result.imperfections),
        *usable_postures(run, robot.settings.get("paper", {})),
    ]
    parts.append(mass_line(mass["estimate"], mass["standard_error"], mass["truth"]))
    if document["books"] is not None:
        parts += [sag_line(run.truth), balance_line(document["books"])]
    return [*parts, "", result.table()]
