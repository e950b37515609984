"""`tulip check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RigFolder, RobotFile
from tulip_testbed.sim.shipped import TULIP


def check_command(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER", help="measurement folder")],
    /,
    *,
    rig: RigFolder = None,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Check a measurement folder for faults.

    Weights, drift, plates, legs, units and more are checked. If the folder is incomplete, the missing parts
    are listed with an example to copy. With --rig RIG the measurements are corrected for the rig's effects.
    Exit code 0: passed, perhaps with warnings; 1: a check failed; 2: could not read.

    Example: tulip check data/first
    """
    from tulip_testbed.cli.terminal import print_json, show, show_verdict, show_whole
    from tulip_testbed.experiments.check_folder import UNREADABLE, check_folder
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.preflight_tables import complaint_lines, counts_line, preflight_report
    from tulip_testbed.experiments.rig_folder import read_rig

    described = described_robot(robot)
    known = () if rig is None else read_rig(rig, described)
    found = check_folder(folder, described, known)
    if as_json:
        print_json(found.document)
    elif found.verdict == UNREADABLE:
        show_whole(complaint_lines(found.document))
    else:
        show(*preflight_report(found.document))
        show_verdict(found.verdict, f" ({counts_line(found.document)})")
    return {UNREADABLE: 2, "fail": 1}.get(found.verdict, 0)
