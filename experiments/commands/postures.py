"""`tulip postures`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from experiments.commands.options import Json, Plan, RobotFile
from experiments.correlation_table import print_correlations
from experiments.description import described_robot
from experiments.scenario import DEFAULT_PLAN, DEFAULT_SEED
from experiments.setting_up import draw_plan, plan_for, planned_parameters, told_apart
from experiments.terminal import console, print_json
from experiments.validate import HIGH_CORRELATION
from identification.base_parameters import base_parameters
from identification.estimators import solve_least_squares
from identification.statistics import high_correlations
from sim.errors import InputError
from sim.measurements import write_plan
from sim.model import TULIP


def postures_command(
    plan: Plan = None,
    /,
    *,
    random: Annotated[bool, tyro.conf.arg(help="draw a new plan")] = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="PLAN", help="the new plan folder")] = None,
    placements: Annotated[int | None, tyro.conf.arg(metavar="INT", help="foot placements; 10")] = None,
    per_placement: Annotated[int | None, tyro.conf.arg(metavar="INT", help="postures on each; 5")] = None,
    seed: Annotated[int | None, tyro.conf.arg(metavar="INT", help=f"of the draws; {DEFAULT_SEED}")] = None,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Draw random feasible postures (--random --out PLAN), or describe a plan.

    Example: tulip postures --random --placements 10 --per-placement 5 --seed 7 --out plans/seven
    """
    described = described_robot(robot)
    parameters = base_parameters(described)
    source = str(out or plan or DEFAULT_PLAN)
    if random:
        made = draw_plan(
            described,
            parameters,
            10 if placements is None else placements,
            5 if per_placement is None else per_placement,
            DEFAULT_SEED if seed is None else seed,
            plan,
            out,
        )
    else:
        drawing = {"out": out, "placements": placements, "per-placement": per_placement, "seed": seed}
        if alone := [option for option, value in drawing.items() if value is not None]:
            raise InputError(f"--{alone[0]}: found without --random, expected both or neither")
        made = plan_for(described, plan)
    parameters = planned_parameters(described, made)
    matrix = told_apart(source, made, parameters)
    if random and out is not None:
        write_plan(out, made)
    _, c = solve_least_squares(matrix, np.zeros(len(matrix)))
    pairs = high_correlations(c, np.arange(1, len(c) + 1), HIGH_CORRELATION)
    document = {
        "plan": source,
        "postures": len(made),
        "placements": len(np.unique(made.placement)),
        "condition_number": float(np.linalg.cond(matrix)),
        "correlations": [{"a": a, "b": b, "rho": rho} for a, b, rho in pairs],
        "made": made.made,
    }
    if as_json:
        print_json(document)
        return 0
    screen = console()
    screen.print(
        f"{document['postures']} postures on {document['placements']} placements, "
        f"condition number {document['condition_number']:.0f}"
    )
    print_correlations(screen, document["correlations"], parameters, made.joint_angles)
    return 0
