"""`tulip compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP

Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(help="run folder")]


def compare_command(
    first: Folder,
    second: Folder,
    /,
    *,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Compare the settings and the results of two runs.

    Both must be of one robot.

    Example: tulip compare runs/first runs/second
    """
    from tulip_testbed.cli.terminal import print_json, show
    from tulip_testbed.experiments.comparison import compare, comparison_report
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.records import read_record

    described = described_robot(robot)
    document = compare(read_record(first, described), read_record(second, described))
    if as_json:
        print_json(document)
    else:
        show(*comparison_report(document))
    return 0
