"""`tulip view`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.cli.terminal import print_json, say
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.saved_discovery import read_discovery
from tulip_testbed.experiments.saved_run import kind_of, read_montecarlo, read_run
from tulip_testbed.sim.errors import InputError, listed
from tulip_testbed.sim.measurements import read_plan
from tulip_testbed.sim.robot import TULIP, Robot

Save = Annotated[Path | None, tyro.conf.arg(metavar="FILE.rrd", help="write the view instead of showing it")]
Serve = Annotated[bool, tyro.conf.arg(help="serve it to a browser of this machine (127.0.0.1) alone")]


def view_command(
    folder: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="folder of a run, a plan or measurements")
    ],
    /,
    *,
    save: Save = None,
    serve: Serve = False,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Look at postures, forces and errors in rerun: a plan, measurements, or a run.

    Example: tulip view runs/first
    """
    if save is not None and serve:
        raise InputError("--save, --serve: found both, expected one of them")
    kind = kind_of(folder)
    described = described_robot(robot)
    from tulip_testbed.viewer import window  # rerun takes half a second to load
    from tulip_testbed.viewer.robot_view import undrawn

    if save is None and not serve:
        window.check_display()
    if bare := undrawn(described.visual_model):
        say(
            f"{described.model_file.name}: no geom shows the links {listed(bare)}; "
            "their frames and masses stand alone"
        )
    title = f"{folder.resolve().name} ({kind})"
    log = _logger(kind, folder, described, title)
    if save is not None:
        size = window.save(save, title, log)
        if as_json:
            print_json({"view": str(save), "bytes": size})
        say(f"View: {save} ({size / 1e6:.1f} MB); open it by `rerun {save}`")
    elif serve:
        window.serve(title, log, partial(_announce, as_json))
    else:
        window.show(title, log)
    return 0


def _logger(kind: str, folder: Path, robot: Robot, title: str) -> Callable[..., None]:
    """What logs the folder's content into a recording; a new kind of folder gets its line here."""
    from tulip_testbed.viewer.discovery_view import log_discovery
    from tulip_testbed.viewer.montecarlo_view import log_montecarlo
    from tulip_testbed.viewer.postures_view import log_postures
    from tulip_testbed.viewer.subject import measured, planned, validated

    if kind == "montecarlo":
        return partial(log_montecarlo, run=read_montecarlo(folder, robot), title=title)
    if kind == "discovery":
        return partial(log_discovery, run=read_discovery(folder, robot), title=title)
    if kind == "run":
        subject = validated(read_run(folder, robot), title)
    elif kind == "plan":
        subject = planned(read_plan(folder, robot), robot, title)
    else:
        subject = measured(folder, robot, title)
    return partial(log_postures, subject=subject)


def _announce(as_json: bool, address: str) -> None:
    if as_json:
        print_json({"address": address})
    say(f"Open {address} in a browser; Ctrl-C ends it.")
