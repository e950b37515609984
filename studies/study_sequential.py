"""Compare ten postures chosen after fifty random ones with ten random ones (docs/studies/planning.md; minutes).

The table is of development seeds 0 to 19.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator

import numpy as np

from studies.runner import Settings, header, row
from tulip_testbed.identification.planning.objectives import Objective, objectives
from tulip_testbed.identification.planning.problem import Problem, planning_problem
from tulip_testbed.identification.planning.sequential import measured_information, optimize_next_placements
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

SETTINGS = Settings(seed=0, only=("condition", "d-optimal", "a-optimal", "worst-standard-error"))
SEEDS = 20
TAKEN, NEXT, PER, HOPS = 10, 2, 5, 40
SIGMA = 4.16e-3  # m


def measured(rig: Rig, plan: PosturePlan, seed: int) -> Measurements:
    """Measure the usable postures of a plan at preset wii in statics, none of them twice."""
    once = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    (run,) = run_statics(solve_plan(once, plan), np.random.SeedSequence([seed, 17]).spawn(1))
    return run.measurements


def as_error(name: str, value: float) -> float:
    """Convert a criterion to the scale of standard errors: -ln det(M) / p is twice a logarithm."""
    return float(np.exp(value / 2)) if name == "d-optimal" else value


def chosen(problem: Problem, goal: Objective, taken: Measurements, seed: int) -> PosturePlan:
    """Choose the next postures as `tulip plan --after TAKEN --placements 2` does."""
    return optimize_next_placements(problem, goal, taken, NEXT, PER, seed, HOPS)


def study(settings: Settings) -> Iterator[str]:
    """Yield a table with a line for each objective."""
    robot = load_robot()
    plate = nominal_plates(robot)[0]
    problem, rig = planning_problem(robot, plate), preset_rig("wii", robot)
    goals = objectives(problem.nominal, SIGMA)
    ratios: dict[str, list[list[float]]] = {name: [] for name in settings.only}
    for seed in range(settings.seed, settings.seed + settings.count(SEEDS)):
        first = measured(rig, random_postures(robot, plate, TAKEN, PER, 1000 + seed), seed)
        known = measured_information(problem, first)
        other = random_postures(robot, plate, NEXT, PER, 2000 + seed)
        for name in settings.only:
            best = chosen(problem, goals[name], first, seed)
            values = []
            for ten in (other, best):
                planned = problem.parameters.regressor(ten.joint_angles).reshape(-1, len(known))
                held = measured_information(problem, measured(rig, ten, 100 + seed))
                values.append([goals[name].value(known + part) for part in (planned.T @ planned, held)])
            random, best_values = np.vectorize(lambda v, name=name: as_error(name, v))(np.array(values))
            ratios[name].append((best_values / random).tolist())
            print(
                f"seed {seed} {name}: planned {ratios[name][-1][0]:.3f}, held {ratios[name][-1][1]:.3f}",
                file=sys.stderr,
            )
    yield header("objective", "median", "smallest", "largest", "median of those that could be held")
    for name, found in ratios.items():
        planned, held = np.array(found).T
        figures = (np.median(planned), planned.min(), planned.max(), np.median(held))
        yield row(name, *(f"{x:.2f}" for x in figures))
