"""`tulip identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import DEFAULT_ESTIMATOR, EstimatorName, Json, RigFolder, RobotFile
from tulip_testbed.sim.shipped import TULIP


def identify_command(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    estimator: EstimatorName = DEFAULT_ESTIMATOR,
    rig: RigFolder = None,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Identify the robot's base parameters from a measurement folder.

    With --rig RIG the measurements are corrected for the rig's effects.
    Example: tulip identify data/first
    """
    from tulip_testbed.cli.terminal import print_json, show
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.identification_report import (
        identification_document,
        identification_report,
    )
    from tulip_testbed.experiments.identify import identify
    from tulip_testbed.experiments.rig_folder import read_rig
    from tulip_testbed.sim.measurements import read_measurements

    described = described_robot(robot)
    measurements = read_measurements(folder)
    adopted = () if rig is None else read_rig(rig, described)
    found = identify(measurements, described, str(folder), estimator, adopted=adopted)
    document = identification_document(found, measurements, None if rig is None else str(rig))
    if as_json:
        print_json(document)
        return 0
    show(*(f"Corrected: {instance.finding}" for instance in adopted))
    show(*identification_report(found, document, measurements, described))
    return 0
