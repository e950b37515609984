"""`tulip identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from tulip_testbed.cli.options import EstimatorName, Json, RigFolder, RobotFile
from tulip_testbed.cli.terminal import print_json, show
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.estimate_report import model_report
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    mass_line,
    models,
    parameter_table,
    standard_table,
    weak_directions,
)
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.identification.estimators import DEFAULT, ESTIMATORS
from tulip_testbed.sim.errors import look_up
from tulip_testbed.sim.measurements import read_measurements
from tulip_testbed.sim.robot import TULIP


def identify_command(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    estimator: EstimatorName = DEFAULT,
    rig: RigFolder = None,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Identify the robot from a measurement folder: base parameters and what they are worth.

    With --rig RIG the measurements are freed of the rig's effects before.
    Example: tulip identify data/first
    """
    look_up("estimator", estimator, ESTIMATORS, "--estimator")
    described = described_robot(robot)
    measurements = read_measurements(folder)
    adopted = () if rig is None else read_rig(rig, described)
    found = identify(measurements, described, str(folder), estimator, adopted=adopted)
    document: dict[str, Any] = {
        "estimator": found.estimator,
        "rig": None if rig is None else str(rig),
        "postures": len(measurements),
        "placements": len(np.unique(measurements.placement)),
        "condition_number": found.full.condition_number,
        "total_mass": {"estimate": found.mass[0], "standard_error": found.mass[1]},
    }
    estimates = {"full": found.full, "simplified": found.simplified}
    fitted = {
        model: model_report(estimate, None).plain()
        | {"hardly_known": weak_directions(estimate, found.parameters)}
        for model, estimate in estimates.items()
    }
    document |= fitted
    if as_json:
        print_json(document)
        return 0
    show(*(f"Corrected: {instance.finding}" for instance in adopted))
    for model in models(described):
        pairs, hardly_known = fitted[model]["correlations"], fitted[model]["hardly_known"]
        angles = measurements.joint_angles
        show(parameter_table(model, fitted[model], found.parameters))
        show(correlation_table(model, pairs, found.parameters, angles) if pairs else NO_CORRELATION)
        show(*([f"Hardly known: {hardly_known}."] if hardly_known else []), "")
    if found.full.standard is not None:
        show(standard_table("full", fitted["full"]["links"], found.full.standard.identifiable))
    show(
        f"Estimator: {found.estimator}. {ESTIMATORS[found.estimator].summary}", LEGEND, mass_line(*found.mass)
    )
    return 0
