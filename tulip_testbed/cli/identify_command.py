"""`tulip identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import DEFAULT_ESTIMATOR, FOLDERS, EstimatorName, Json, RigFolder, RobotFile
from tulip_testbed.sim.shipped import TULIP

TolerancesOf = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(
        metavar="FAMILY=VALUE",
        help="what is usual for a family of ordinary imperfections of this laboratory (SI units; 0: exact)",
    ),
]


def identify_command(
    folder: Annotated[tuple[Path, ...], tyro.conf.Positional, FOLDERS],
    /,
    *,
    estimator: EstimatorName = DEFAULT_ESTIMATOR,
    rig: RigFolder = None,
    tolerance: TolerancesOf = (),
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Identify the robot's base parameters from a measurement folder.

    With --rig RIG the measurements are corrected for the rig's effects.

    Example: tulip identify data/first

    Example: tulip identify data/monday data/tuesday

    Example: tulip identify data/first --tolerance encoder-offset=0.001
    """
    from tulip_testbed.calibration.families import read_tolerances
    from tulip_testbed.cli.terminal import print_json, show
    from tulip_testbed.experiments.check_folder import warn_of_faults
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.identification_report import (
        identification_document,
        identification_report,
    )
    from tulip_testbed.experiments.identify import identify, warn_of_unrest
    from tulip_testbed.experiments.rig_folder import read_rig
    from tulip_testbed.measurements.joined import read_experiments, separate

    described = described_robot(robot)
    measurements, source = read_experiments(folder), ", ".join(map(str, folder))
    adopted = () if rig is None else read_rig(rig, described)
    stated = read_tolerances(tolerance)
    found = identify(measurements, described, source, estimator, adopted=adopted, tolerances=stated)
    for one, where in zip(separate(measurements), folder, strict=True):
        warn_of_faults(one, described, adopted, str(where), stated)
    warn_of_unrest(found, source)
    document = identification_document(found, measurements, None if rig is None else str(rig))
    if as_json:
        print_json(document)
        return 0
    show(*(f"Corrected: {instance.finding}" for instance in adopted))
    show(*identification_report(found, document, measurements, described))
    return 0
