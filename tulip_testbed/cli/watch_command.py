"""`tulip watch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import RobotFile
from tulip_testbed.sim.shipped import TULIP


def watch_command(
    folder: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER", help="measurement folder that grows")
    ],
    /,
    *,
    plan: Annotated[Path, tyro.conf.arg(help="plan folder that is being measured, or a shipped plan's name")],
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="STATE", help="file that keeps the state: a watch that was killed goes on"),
    ] = None,
    target: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME=MM [NAME=MM ...]",
            help="standard errors at which to stop, in mm, by base parameter or all",
        ),
    ] = (),
    stdin: Annotated[
        bool, tyro.conf.arg(help="read the rows as CSV lines after a header from standard input")
    ] = False,
    once: Annotated[bool, tyro.conf.arg(help="judge the rows that are there and end")] = False,
    view: Annotated[bool, tyro.conf.arg(help="also show the day in rerun, in a browser")] = False,
    robot: RobotFile = TULIP,
    as_json: Annotated[
        bool, tyro.conf.arg(name="json", help="print one line of JSON a posture on stdout")
    ] = False,
) -> int:
    """Check postures while they are measured, and say when to stop.

    FOLDER is a measurement folder whose manifest.json is written and whose postures.csv grows; nothing is
    written into it. Each row is compared with the postures before it, the robot's CAD model, the repeats and
    the data sheets' noise. The command ends when every posture is measured, or by Ctrl-C. PLAN is a plan
    folder or the name of a shipped plan.

    Example: tulip watch lab/monday --plan random --out runs/monday.state --target all=2

    Example: logger | tulip watch lab/monday --plan plans/next --stdin --json
    """
    import sys
    from contextlib import ExitStack

    import tulip_testbed
    from tulip_testbed.base.errors import InputError
    from tulip_testbed.cli.terminal import live_table, print_line_of_json, say, show
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.watching.watch_day import read_targets
    from tulip_testbed.experiments.watching.watch_tables import LATEST, advice, error_table, line, watch_table
    from tulip_testbed.sim.plan_folder import read_plan
    from tulip_testbed.sim.shipped import plan_folder

    targets, described = read_targets(target), described_robot(robot)
    planned = read_plan(plan_folder(plan), described)
    if stdin and sys.stdin is None:
        raise InputError("--stdin: standard input is closed, expected rows")
    rows = sys.stdin.buffer if stdin else None
    arrivals = tulip_testbed.watch(folder, planned, described, out, targets, follow=not once, rows=rows)
    latest, last = [], None
    with ExitStack() as open_now:
        log = None
        if view:
            from tulip_testbed.viewer.watch_view import served_watch

            log = open_now.enter_context(served_watch(planned, described, say))
        update = None if as_json else open_now.enter_context(live_table())
        for arrival in arrivals:
            latest = [*latest, arrival][-LATEST:]
            if arrival.verdict is None:
                say(f"tulip: {arrival.problem}")
            else:
                last = arrival.verdict
                if log is not None:
                    log(last)
                if as_json:
                    print_line_of_json(last.document())
                    if last.verdict != "ok" or last.stop:
                        say(line(last))
            if update is not None:
                told = "" if arrival.verdict is None else line(arrival.verdict)
                update(watch_table(latest, targets), told)
    if not latest:
        say("No row has arrived.")
    if last is not None and not as_json:
        show(error_table(last, targets), " ".join(advice(last, targets)))
    return 0
