"""`tulip discover`."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from tulip_testbed.cli.options import CORES, Json, RobotFile, Workers
from tulip_testbed.discovery.discover import Discovery
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.discovering import discover_effects
from tulip_testbed.experiments.discovery_record import discovery_record, write_discovery
from tulip_testbed.experiments.terminal import ERR, console, print_json, print_table, progress
from tulip_testbed.sim.files import check_new
from tulip_testbed.sim.measurements import read_measurements
from tulip_testbed.sim.robot import TULIP

STAGES = 4
NEW = Annotated[Path | None, tyro.conf.arg(help="run folder to write; runs/discover-DATE-TIME if not given")]
NoCheck = Annotated[
    bool,
    tyro.conf.arg(
        help="do not simulate adopted physics in full dynamics (saves up to two minutes; what instruments "
        "misread is not simulated: predictions undo it exactly)"
    ),
]


def discover_command(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    out: NEW = None,
    no_check: NoCheck = False,
    seed: int = 0,
    workers: Workers = CORES,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Find what the model lacks: where it disagrees with measurements, which effect explains it.

    The verdict is `named`, `ambiguous`, `unknown` or `none`. What is named is added to the model: the run
    folder's rig serves `tulip simulate --rig` and `tulip identify --rig`.
    Example: tulip discover data/first --out runs/found
    """
    out = out or Path("runs") / f"discover-{datetime.now():%Y%m%d-%H%M%S-%f}"
    check_new(out)
    described = described_robot(robot)
    measurements = read_measurements(folder)
    with ExitStack() as bars:
        found = discover_effects(
            measurements,
            described,
            seed,
            not no_check,
            workers,
            str(folder),
            lambda what, total: bars.enter_context(progress(what, total)),
        )
    record = write_discovery(out, discovery_record(found, str(folder), seed, no_check))
    document = record.report.plain()
    if as_json:
        print_json(document)
        return 0
    _show(found.discovery, document, found.story)
    ERR.print(f"Run folder: {out}")
    return 0


def _show(found: Discovery, document: dict, lines: list[str]) -> None:
    screen = console()
    screen.print(f"Verdict: [bold]{found.verdict}[/bold]")
    for line in lines:
        screen.print(line, markup=False, highlight=False, soft_wrap=True)
    table = Table(title="Residuals on held-out placements, times the noise")
    for heading in ("channel", "before", "after", "by chance up to"):
        table.add_column(heading, justify="left" if heading == "channel" else "right")
    for channel, gap in document["gap"].items():
        if channel != "heldout_rms_mm" and gap["after"] is not None:
            table.add_row(channel, *(f"{gap[key]:.2f}" for key in ("before", "after", "floor")))
    if table.rows:
        print_table(screen, table)
    moved = [row for row in document["parameters"] if abs(row["moved_in_standard_errors"]) > 0.5]
    if moved:
        table = Table(title="Base parameters that move by more than half a standard error, mm")
        for heading in ("number", "name", "before", "after", "standard error"):
            table.add_column(heading, justify="left" if heading == "name" else "right")
        for row in moved:
            values = (row["before_mm"], row["after_mm"], row["standard_error_mm"])
            table.add_row(str(row["number"]), row["name"], *(f"{v:.2f}" for v in values))
        print_table(screen, table)
    if document["check"]:
        check = document["check"]
        screen.print(
            f"In full dynamics {check['postures']} of {check['tried']} postures stood; what the adopted "
            f"effects leave there is {check['left_over_noise']:.2f} times the noise."
            if check["reason"] is None
            else f"In full dynamics nothing could be compared: {check['reason']}."
        )
