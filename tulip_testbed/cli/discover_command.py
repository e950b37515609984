"""`tulip discover`."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import tyro

from tulip_testbed.cli.options import CORES, Json, RobotFile, Workers
from tulip_testbed.cli.terminal import print_json, progress, say, show, show_verdict
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.discovering import discover_effects
from tulip_testbed.experiments.discovery_record import discovery_record, write_discovery
from tulip_testbed.experiments.discovery_tables import (
    MOVED,
    candidate_table,
    dynamics_line,
    gap_table,
    moved_table,
)
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
    _show(document, found.story)
    say(f"Run folder: {out}")
    return 0


def _show(document: dict[str, Any], lines: list[str]) -> None:
    show_verdict(document["verdict"])
    show(*lines, "")
    if any(entry and entry["after"] is not None for entry in document["gap"].values()):
        show(gap_table(document["gap"]))
    if document["candidates"]:
        show(candidate_table(document["candidates"]))
    if (moved := moved_table(document["parameters"], MOVED)).rows:
        show(moved)
    if document["check"]:
        show(dynamics_line(document["check"]))
