"""`tulip predict`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP

Part = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        metavar="A-B | placement:A-B", help="postures by number, or placements; the rest if left out"
    ),
]


def predict_command(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER", help="measurement folder")],
    /,
    *,
    robot: RobotFile = TULIP,
    train: Part = (),
    test: Part = (),
    as_json: Json = False,
) -> int:
    """Ask whether the identified model predicts better than CAD.

    Models are the robot's own masses (CAD), CAD and a constant, the identified one, and the identified one
    with a prior at CAD. Each predicts the centre of pressure of postures that took no part in its training:
    blocks of placements, halves, or those that --train and --test name.

    Example: tulip predict data/first
    """
    from tulip_testbed.cli.terminal import print_json, show, working_on
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.predict import predict
    from tulip_testbed.measurements import read_experiments

    described = described_robot(robot)
    measurements = read_experiments([folder])
    with working_on("predicting postures from others"):
        found = predict(measurements, described, train, test, str(folder))
    if as_json:
        print_json(found.plain())
    else:
        show(*found.parts())
    return 0
