"""An identification as a JSON document, and as tables and sentences."""

from __future__ import annotations

from typing import Any

import numpy as np

from tulip_testbed.base.table import Table
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table
from tulip_testbed.experiments.estimate_report import model_report
from tulip_testbed.experiments.family_tables import calibration_document, calibration_report
from tulip_testbed.experiments.identify import ESTIMATORS, Identification
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    mass_line,
    models,
    parameter_table,
    standard_table,
    weak_directions,
)
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.robot import Robot


def identification_document(
    found: Identification, measurements: Measurements, rig: str | None
) -> dict[str, Any]:
    """Return the JSON document of an identification.

    Args:
        rig: folder of the effects that the measurements were corrected for; None: they were not.
    """
    document: dict[str, Any] = {
        "estimator": found.estimator,
        "rig": rig,
        "postures": len(measurements),
        "placements": len(np.unique(measurements.placement)),
        "condition_number": found.full.condition_number,
        "at_rest": found.at_rest,
        "total_mass": {"estimate": found.mass[0], "standard_error": found.mass[1]},
    }
    for model, estimate in (("full", found.full), ("simplified", found.simplified)):
        weak = weak_directions(estimate, found.parameters)
        document[model] = model_report(estimate, None).plain() | {"hardly_known": weak}
    if found.hidden:
        document["hidden_by_zeros"] = found.hidden
    if found.calibration is not None:
        document |= calibration_document(found.calibration, found.full.names)
    return document


def identification_report(
    found: Identification, document: dict[str, Any], measurements: Measurements, robot: Robot
) -> list[Table | str]:
    """Return the tables and sentences of an identification."""
    parts: list[Table | str] = []
    for model in models(robot):
        pairs, weak = document[model]["correlations"], document[model]["hardly_known"]
        angles = measurements.joint_angles
        parts += [
            parameter_table(model, document[model], found.parameters, at_rest=found.at_rest),
            correlation_table(model, pairs, found.parameters, angles) if pairs else NO_CORRELATION,
            *([f"Weakly determined: {weak}."] if weak else []),
            "",
        ]
    if found.full.standard is not None:
        parts.append(standard_table("full", document["full"]["links"], found.full.standard.identifiable))
    if found.hidden:
        parts.append(f"Unknown zeros: {found.hidden}.")
    if found.calibration is not None:
        parts += calibration_report(found.calibration, found.full.names)
    summary = ESTIMATORS[found.estimator]
    return [*parts, f"Estimator: {found.estimator}. {summary}", LEGEND, mass_line(*found.mass)]
