"""Settings of a search for a plan, checked before the work, and the search from each random start."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError, at_least, at_most
from tulip_testbed.base.machine import machine
from tulip_testbed.base.resumable import ResumableFolder
from tulip_testbed.base.table_files import MOST_ROWS, software
from tulip_testbed.experiments.usable_plan import as_plan, enough, plan_hash
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.planning.objectives import Objective
from tulip_testbed.identification.planning.optimal_plan import (
    SearchTask,
    objective_by_name,
    with_repeats,
)
from tulip_testbed.identification.planning.problem import PlanningProblem, planning_problem
from tulip_testbed.identification.planning.search_defaults import HOPS
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.robot_check import warn_of_robot
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.scene_check import check_scene

SIGMA_MM = 4.16  # the paper's residual per axis (eq. 14)


@dataclass(frozen=True)
class PlanSettings:
    """The settings of a plan.

    Attributes:
        seed: of everything random.
        objective: "condition", "d-optimal", "a-optimal", ..., see `identification.planning.objectives`.
        placements, postures_per_placement: its size.
        hops: exchanges of a placement's postures.
        repeats: postures that come twice: half in the same placement, half in another one.
        right, left: postures on the right and on the left foot alone, optimised together with the others.
    """

    seed: int = 1
    objective: str = "condition"
    placements: int = 10
    postures_per_placement: int = 5
    hops: int = HOPS
    repeats: int = 0
    right: int = 0
    left: int = 0

    @property
    def on_one_foot(self) -> dict[str, int]:
        """Numbers of postures on one foot that are optimised together with those on both, none if 0."""
        counts = {"right": self.right, "left": self.left}
        return {foot: count for foot, count in counts.items() if count}


def state_folder(out: Path) -> Path:
    """Return where an interrupted search leaves its states, next to its plan."""
    return out.with_name(f".{out.name}.search")


@dataclass(frozen=True)
class PlanSearch:
    """A search for a plan of a robot, checked and ready.

    Attributes:
        measured: what was measured before, None: nothing.
        problem: the constraints. goal: what is made small.
    """

    robot: Robot
    settings: PlanSettings
    measured: Measurements | None
    problem: PlanningProblem
    goal: Objective

    def task(self, seed: int | None = None) -> SearchTask:
        """Return the search from a random start.

        Args:
            seed: of the start; the settings' if None.
        """
        wanted = self.settings
        return SearchTask(
            self.problem,
            self.goal,
            wanted.placements,
            wanted.postures_per_placement,
            wanted.seed if seed is None else seed,
            wanted.hops,
            wanted.on_one_foot,
            self.measured,
        )

    def folder(self, out: Path) -> ResumableFolder:
        """Return the folder of the search's states, next to the plan that it makes."""
        made_with = {
            "settings": dataclasses.asdict(self.settings),
            "measured": None if self.measured is None else plan_hash(as_plan(self.robot, self.measured)),
            "robot": self.robot.hashes,
            "software": software(),
            "machine": machine(),
        }
        return ResumableFolder(state_folder(out), "search.json", made_with, "search", "states")

    def extended(self, plan: PosturePlan) -> PosturePlan:
        """Add the repeats that the settings ask for."""
        wanted = self.settings
        return with_repeats(plan, wanted.repeats, wanted.seed) if wanted.repeats else plan


def set_up_search(
    robot: Robot, settings: PlanSettings, measured: Measurements | None = None, trials: int = 1
) -> PlanSearch:
    """Check what a plan is to be, before the work.

    Args:
        measured: what was measured before: the plan is to tell most next.
        trials: plans that will be joined.
    """
    for name, least in (
        *(("seed", 0), ("placements", 1), ("postures_per_placement", 1), ("hops", 0)),
        *(("repeats", 0), ("right", 0), ("left", 0)),
    ):
        at_least(name, getattr(settings, name), least)
    placements, per = settings.placements, settings.postures_per_placement
    at_most("placements, postures_per_placement", placements * per, MOST_ROWS)
    if settings.repeats > (most := trials * placements * per):
        raise InputError(f"repeats: found {settings.repeats}, expected at most the plan's {most} postures")
    if (counts := settings.on_one_foot) and measured is not None:
        raise InputError("right, left: found postures on one foot after measurements, expected none")
    check_scene(preset_rig("ideal", robot))
    warn_of_robot(robot)
    rows = np.array(["double", *counts]) if measured is None else measured.support
    support = common_support(rows)
    problem = planning_problem(robot, nominal_plates(robot)[0], support=support)
    goal = objective_by_name(problem, settings.objective, 1e-3 * SIGMA_MM)
    taken = sum(counts.values()) if measured is None else len(measured)
    enough("placements, postures_per_placement", taken + placements * per, problem.parameters)
    return PlanSearch(robot, settings, measured, problem, goal)
