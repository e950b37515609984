"""`tulip report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP


def report_command(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help="run folder")],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.html", help="the page, a new file")],
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Write a run as one HTML page that needs no network.

    The page shows the verdict, tables, figures and settings.

    Example: tulip report runs/first --out first.html
    """
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, say
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.records import read_record
    from tulip_testbed.pages import ENDING

    check_new(out, ENDING)
    record = read_record(folder, described_robot(robot))
    from tulip_testbed.pages.report_page import write_page  # loads slowly

    page = write_page(out, record)
    size = out.stat().st_size
    if as_json:
        print_json({"report": str(out), "bytes": size, "left_out": list(page.missing)})
    for note in page.missing:
        say(f"Left out: {note}")
    say(f"Report: {out} ({size / 1e6:.1f} MB)")
    return 0
