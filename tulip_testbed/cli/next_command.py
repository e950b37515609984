"""`tulip next`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP


def next_command(
    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help="run folder of a discovery")
    ],
    /,
    *,
    out: Annotated[Path | None, tyro.conf.arg(help="plan folder to write, of the best experiment")] = None,
    plan: Annotated[
        Path | None,
        tyro.conf.arg(
            help="plan folder to choose from, or a shipped plan's name; the measured postures if left out"
        ),
    ] = None,
    seed: Annotated[int, tyro.conf.arg(help="seed of the draws of the expectation")] = 0,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Rank the experiments that would settle an ambiguous discovery.

    RUN is the run folder of `tulip discover`. Experiments are manipulations of the laboratory and a choice
    of postures; they are ranked by the doubt that each is expected to settle per minute. With --out the best
    is written as a plan folder with its manipulations as numbered steps (steps.md), which
    `tulip simulate --experiment` carries out.

    Example: tulip next runs/found --out plans/next
    """
    from tulip_testbed.base.errors import at_least
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, say, show, working_on
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.discovery_record import read_discovery
    from tulip_testbed.experiments.proposed_experiment import write_experiment_plan
    from tulip_testbed.sim.plan_folder import read_plan
    from tulip_testbed.sim.shipped import plan_folder

    at_least("seed", seed, 0)
    if out is not None:
        check_new(out)
    described = described_robot(robot)
    record = read_discovery(run, described)
    chosen = None if plan is None else read_plan(plan_folder(plan), described)
    with working_on("weighing experiments"):
        found = record.propose(chosen, seed)
    if out is not None:
        write_experiment_plan(out, found)
    if as_json:
        print_json(found.document())
    else:
        show(*found.parts())
    if out is not None:
        say(f"Plan folder: {out}")
    return 0
