"""`tulip check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from tulip_testbed.cli.options import Json, RigFolder, RobotFile
from tulip_testbed.cli.terminal import print_json, show, show_verdict, show_whole
from tulip_testbed.experiments.check_folder import UNREADABLE, check_folder
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.preflight_tables import advice_table, complaint_lines, finding_table
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.sim.robot import TULIP


def check_command(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    rig: RigFolder = None,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Check a measurement folder before anybody trusts it: weights, drift, plates, legs, units and more.

    Exit code 0: passed, perhaps with warnings; 1: a check failed; 2: could not read. What an
    incomplete folder lacks is listed, with an example to copy. With --rig RIG the measurements
    are freed of the rig's effects before.
    Example: tulip check data/first
    """
    described = described_robot(robot)
    known = () if rig is None else read_rig(rig, described)
    document = check_folder(folder, described, known).document
    if as_json:
        print_json(document)
    else:
        _show(document)
    return {UNREADABLE: 2, "fail": 1}.get(document["verdict"], 0)


def _show(document: dict[str, Any]) -> None:
    if document["verdict"] == UNREADABLE:
        show_whole(complaint_lines(document))
        return
    show(finding_table(document["checks"]))
    if (advice := advice_table(document["checks"])).rows:
        show(advice)
    counts = ", ".join(f"{count} {result}" for result, count in document["counts"].items() if count)
    show("{rows} rows of {postures} postures on {placements} placements.".format_map(document))
    show_verdict(document["verdict"], f" ({counts})")
