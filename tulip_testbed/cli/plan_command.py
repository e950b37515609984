"""`tulip plan`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import DEFAULT_SEED, HOPS, SOLVERS, Json, NoisyPreset, RobotFile, Seed
from tulip_testbed.sim.shipped import TULIP


def plan_command(
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="PLAN", help="the new plan folder")],
    seed: Seed = DEFAULT_SEED,
    objective: Annotated[str, tyro.conf.arg(help="condition, d-optimal, a-optimal, ...")] = "condition",
    placements: Annotated[int, tyro.conf.arg(help="foot placements")] = 10,
    postures_per_placement: Annotated[int, tyro.conf.arg(help="postures on each placement")] = 5,
    hops: Annotated[int, tyro.conf.arg(help="exchanges of a placement's postures")] = HOPS,
    table1: Annotated[
        bool, tyro.conf.arg(help="the paper's six trials (seeds 101 to 106); joins the best three")
    ] = False,
    after: Annotated[
        Path | None,
        tyro.conf.arg(metavar="MEASUREMENTS", help="measurements: find postures that add most to them"),
    ] = None,
    single_support: Annotated[
        int, tyro.conf.arg(metavar="N", help="postures on the right foot alone, after the others")
    ] = 0,
    right: Annotated[
        int, tyro.conf.arg(metavar="N", help="postures on the right foot, optimised together with the others")
    ] = 0,
    left: Annotated[
        int, tyro.conf.arg(metavar="N", help="postures on the left foot, optimised together with the others")
    ] = 0,
    repeats: Annotated[
        int,
        tyro.conf.arg(
            metavar="N", help="postures that come twice: half in the same placement, half in another one"
        ),
    ] = 0,
    solver: Annotated[str, tyro.conf.arg(help="solver of the last round: slsqp, or ipopt (slow)")] = SOLVERS[
        0
    ],
    preset: NoisyPreset = "wii",
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Search for optimal postures (section IV of the paper).

    The search starts from random feasible postures and keeps every constraint. Ctrl-C writes the best plan so
    far; the same command then continues the search.

    Example: tulip plan --out plans/best --seed 3 --objective condition
    """
    import time

    from tulip_testbed.base.errors import InputError
    from tulip_testbed.cli.plan_search import searched, table1_trials
    from tulip_testbed.cli.terminal import print_json, say, show
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.plan_state import state_file
    from tulip_testbed.experiments.planning_run import (
        PlanSettings,
        check_out,
        measured_for,
        set_up_search,
    )
    from tulip_testbed.experiments.written_plan import CHOSEN, search_report, written_plan
    from tulip_testbed.identification.base_parameters import base_parameters

    check_out(out)
    if table1 and after is not None:
        raise InputError("--after: found with --table1, expected one of them")
    if table1 and (right or left):
        raise InputError("--right, --left: found with --table1, expected one of them")
    own = described_robot(robot)
    measured = None if after is None else measured_for(own, after, base_parameters(own).tree.joints)
    size = (placements, postures_per_placement, hops)
    settings = PlanSettings(seed, objective, *size, single_support, repeats, solver, right, left)
    search = set_up_search(own, settings, measured, CHOSEN if table1 else 1)
    if table1:
        return table1_trials(search, out, preset, as_json)
    began = time.perf_counter()
    plan, finished = searched(search.job(), state_file(out), f"seed {seed}")
    document = written_plan(own, search.extended(plan) if finished else plan, out, preset, measured)
    if finished:
        state_file(out).unlink(missing_ok=True)
    document["wall_s"] = time.perf_counter() - began
    if as_json:
        print_json(document)
    else:
        show(*search_report(own, document, out, measured))
    say(f"Plan folder: {out}")
    if not finished:
        say("tulip: interrupted; this is the best plan so far, the same command goes on from it")
    return 0 if finished else 130
