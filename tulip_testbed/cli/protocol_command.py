"""`tulip protocol`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, Plan, Preset, RobotFile
from tulip_testbed.sim.shipped import TULIP


def protocol_command(
    plan: Plan = None,
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER", help="new folder")],
    preset: Annotated[
        Preset | None,
        tyro.conf.arg(help="sensors whose data sheet starts the measurements; unknown if left out"),
    ] = None,
    speed: Annotated[float, tyro.conf.arg(help="largest speed of a joint between postures, rad/s")] = 0.5,
    repeats: Annotated[
        int,
        tyro.conf.arg(
            help="postures that are measured twice if the plan repeats none; at most every fifth is"
        ),
    ] = 10,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Write what a laboratory needs to carry a plan out.

    FOLDER gets protocol.html (pages to print: drawings to scale, postures, boxes to tick, checklists), plan
    (the plan in the order in which it is measured), trajectories (CSV, and ROS 2 JointTrajectory as YAML),
    measurements (the start of the measurement folder) and rows.csv (the rows to fill in).

    Example: tulip protocol optimal --preset wii --out monday
    """
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, progress, say, show, working_on
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.protocols.protocol_run import (
        ProtocolSettings,
        check_settings,
        protocol_of,
        steps_of,
    )
    from tulip_testbed.experiments.usable_plan import plan_for
    from tulip_testbed.pages.protocol_page import contents, write_protocol

    check_new(out)
    settings = ProtocolSettings(preset, speed, repeats)
    check_settings(settings)
    described = described_robot(robot)
    given = plan_for(described, plan)
    with progress("placements", steps_of(given, settings)) as bar:
        made = protocol_of(described, given, settings, bar)
    with working_on("drawing"):
        missing = write_protocol(out, made)
    if as_json:
        print_json(made.document() | {"missing": missing, "files": contents(out)})
        return 0
    show(*made.parts(), *missing)
    say(f"Protocol: {out}")
    return 0
