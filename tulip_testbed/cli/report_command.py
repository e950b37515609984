"""`tulip report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.cli.terminal import print_json, say
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.run_folder import check_new
from tulip_testbed.experiments.saved_discovery import read_discovery
from tulip_testbed.experiments.saved_run import read_montecarlo, read_run, run_kind
from tulip_testbed.sim.robot import TULIP


def report_command(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(help="run folder")],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.html", help="the page, a new file")],
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Write a run as one HTML page that needs no network: verdict, tables, figures, settings.

    Example: tulip report runs/first --out first.html
    """
    check_new(out)
    kind = run_kind(folder)
    described = described_robot(robot)
    from tulip_testbed.pages.discovery_page import discovery_page
    from tulip_testbed.pages.page import montecarlo_page, validation_page, write_page  # loads slowly

    if kind == "run":
        page = validation_page(read_run(folder, described))
    elif kind == "discovery":
        page = discovery_page(read_discovery(folder, described))
    else:
        page = montecarlo_page(read_montecarlo(folder, described))
    size = write_page(out, page)
    if as_json:
        print_json({"report": str(out), "bytes": size, "left_out": list(page.missing)})
    for note in page.missing:
        say(f"Left out: {note}")
    say(f"Report: {out} ({size / 1e6:.1f} MB)")
    return 0
