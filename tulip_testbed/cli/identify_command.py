"""`tulip identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from tulip_testbed.cli.options import EstimatorName, Json, RigFolder, RobotFile
from tulip_testbed.experiments.correlation_table import print_correlations
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.estimate_report import model_report
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    models,
    parameter_table,
    placements_line,
    residual_line,
    standard_table,
    weak_directions,
)
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.experiments.terminal import console, print_json, print_table
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
    screen = console()
    for instance in adopted:
        screen.print(f"Corrected: {instance.finding}", markup=False, highlight=False, soft_wrap=True)
    for model in models(described):
        title = f"{model.capitalize()} model, mm"
        print_table(screen, parameter_table(title, fitted[model], found.parameters, {}, model))
        screen.print(residual_line(fitted[model]))
        screen.print(placements_line(fitted[model]))
        pairs = fitted[model]["correlations"]
        print_correlations(screen, pairs, found.parameters, measurements.joint_angles)
        if fitted[model]["hardly_known"]:
            screen.print(f"Hardly known: {fitted[model]['hardly_known']}", markup=False)
        screen.print()
    screen.print(f"Estimator: {found.estimator}. {ESTIMATORS[found.estimator].summary}")
    if found.full.standard is not None:
        print_table(screen, standard_table(found.full.standard))
        screen.print(found.full.standard.visible)
    screen.print(LEGEND)
    screen.print(f"Total mass {found.mass[0]:.3f} +- {found.mass[1]:.3f} kg")
    return 0
