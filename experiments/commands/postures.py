"""`tulip postures`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.commands.options import Json, Plan, RobotFile, Seed
from experiments.description import described_robot
from experiments.scenario import DEFAULT_PLAN, DEFAULT_SEED
from experiments.setting_up import draw_plan, told_apart
from experiments.tables import (
    correlation_lines,
)
from experiments.terminal import console, print_json
from experiments.validate import HIGH_CORRELATION
from identification.base_parameters import base_parameters
from identification.estimators import solve_least_squares
from identification.statistics import high_correlations
from sim.errors import InputError
from sim.measurements import read_plan, write_plan
from sim.model import TULIP, load_model


def postures_command(
    plan: Plan = None,
    /,
    *,
    random: bool = False,
    out: Path | None = None,
    placements: int = 10,
    per_placement: int = 5,
    seed: Seed = DEFAULT_SEED,
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
        made = draw_plan(described, parameters, placements, per_placement, seed, plan, out)
    else:
        if out is not None:
            raise InputError("--out: found without --random, expected both or neither")
        made = read_plan(plan or DEFAULT_PLAN, described, load_model(described))
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
    screen.print("Correlations above 0.85 in size (eq. 15):")
    for line in correlation_lines(document["correlations"], parameters, made.joint_angles):
        screen.print(f"  {line}", markup=False)
    return 0
