"""`tulip postures`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from tulip_testbed.cli.options import DEFAULT_SEED, Json, NoisyPreset, Plan, RobotFile
from tulip_testbed.sim.shipped import TULIP


def postures_command(
    plan: Plan = None,
    /,
    *,
    random: Annotated[bool, tyro.conf.arg(help="draw a new plan")] = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="PLAN", help="the new plan folder")] = None,
    placements: Annotated[
        int | None, tyro.conf.arg(metavar="INT", help="foot placements; 10 if left out")
    ] = None,
    per_placement: Annotated[
        int | None, tyro.conf.arg(metavar="INT", help="postures on each placement; 5 if left out")
    ] = None,
    seed: Annotated[
        int | None, tyro.conf.arg(metavar="INT", help=f"seed of the draws; {DEFAULT_SEED} if left out")
    ] = None,
    after: Annotated[
        Path | None, tyro.conf.arg(metavar="MEASUREMENTS", help="describe the plan together with these")
    ] = None,
    draw: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="pictures: support-polygons.svg, postures.png")
    ] = None,
    preset: NoisyPreset = "wii",
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Draw random feasible postures, or describe a plan.

    With --random --out PLAN a new plan is drawn, else PLAN is read. --draw DIR draws pictures of it.

    Example: tulip postures --random --placements 10 --per-placement 5 --seed 7 --out plans/seven
    """
    from tulip_testbed.base.errors import InputError
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, progress, say, show
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.plan_description import described_plan, plan_report
    from tulip_testbed.experiments.planning_run import as_plan, joined, measured_for
    from tulip_testbed.experiments.usable_plan import (
        DEFAULT_PLAN,
        identifiable_regressor,
        plan_for,
        planned_parameters,
        random_plan,
    )
    from tulip_testbed.identification.base_parameters import base_parameters
    from tulip_testbed.sim.plan_folder import write_plan

    if draw is not None:
        check_new(draw)
    described = described_robot(robot)
    parameters = base_parameters(described)
    source = str(out or plan or DEFAULT_PLAN)
    if random:
        if plan is not None or out is None:
            raise InputError("--random: give the name of the new plan as --out PLAN, and no plan to read")
        check_new(out)
        placements = 10 if placements is None else placements
        per = 5 if per_placement is None else per_placement
        with progress("drawing postures", max(placements * per, 1)) as advance:
            made = random_plan(
                described, placements, per, DEFAULT_SEED if seed is None else seed, progress=advance
            )
    else:
        drawing = {"out": out, "placements": placements, "per-placement": per_placement, "seed": seed}
        if alone := [option for option, value in drawing.items() if value is not None]:
            raise InputError(f"--{alone[0]}: found without --random, expected both or neither")
        made = plan_for(described, plan)
    taken = None
    if after is not None:
        taken = as_plan(described, measured_for(described, after, parameters.tree.joints))
    whole = made if taken is None else joined([taken, made])
    parameters = planned_parameters(described, whole)
    identifiable_regressor(source, described, whole)
    document: dict[str, Any] = {
        "plan": source,
        "postures": len(made),
        "placements": len(set(made.placement.tolist())),
        **described_plan(described, made, preset, taken),
        "made": made.made,
    }
    if random and out is not None:
        write_plan(out, made)
    missing = None
    if draw is not None:
        from tulip_testbed.drawings import write_pictures

        if missing := write_pictures(draw, described, made):
            say(f"tulip: no postures.png: {missing}")
        say(f"Pictures: {draw}")
    code = 0 if missing is None else 2
    if as_json:
        print_json(document)
        return code
    show(
        f"{document['postures']} postures on {document['placements']} placements, "
        f"condition number {document['condition_number']:.0f}.",
        *plan_report(document, parameters, whole),
    )
    return code
