"""`tulip robot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json


def robot_command(
    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE", help="MJCF or URDF")],
    /,
    *,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="new folder: robot.toml, robot.xml, robot.png")
    ] = None,
    feet: Annotated[
        tuple[str, str] | None,
        tyro.conf.arg(metavar="RIGHT LEFT", help="links of the feet, if their geometry does not tell"),
    ] = None,
    sole: Annotated[
        tuple[float, float, float, float] | None,
        tyro.conf.arg(
            metavar="FRONT REAR WIDTH HEIGHT",
            help="how far a sole reaches before and behind the ankle, its width, the ankle's height [m]",
        ),
    ] = None,
    as_json: Json = False,
) -> int:
    """Prepare a published MJCF or URDF for every other command.

    Feet, soles, front, drives and a standing posture are found; what the file does not say is assumed and
    listed. The file is not changed. With --out DIR a description is written that can be edited.

    Example: tulip robot g1_29dof.urdf --out my/g1
    """
    from tulip_testbed.base.errors import InputError
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, say, show, working_on
    from tulip_testbed.drawings import standing_picture
    from tulip_testbed.experiments.robot_import.import_tables import import_report
    from tulip_testbed.experiments.robot_import.robot_import import import_robot
    from tulip_testbed.sim.robot import Robot

    if out is not None:
        check_new(out)
    with working_on("looking for feet, soles and a standing posture"):
        found = import_robot(file, feet or (), sole or ())
    missing = ""

    def picture(robot: Robot) -> bytes | None:
        nonlocal missing
        try:
            return standing_picture(robot)
        except InputError as problem:
            missing = str(problem)
            return None

    if out is not None:
        with working_on("drawing it on its plates"):
            found.write(out, picture)
    if as_json:
        print_json(found.plain())
    else:
        show(*import_report(found))
    if out is not None:
        say(f"Description: {out / 'robot.toml'}" + (f" (no picture: {missing})" if missing else ""))
    return 0
