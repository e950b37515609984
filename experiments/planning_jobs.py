"""The searches for plans as jobs that can be carried out from any of their states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from tulip_testbed.base.files import sha256
from tulip_testbed.identification.planning.objectives import Objective
from tulip_testbed.identification.planning.optimal_plan import (
    Start,
    measured_information,
    optimize_plan,
    plan_from_state,
    random_start,
)
from tulip_testbed.identification.planning.problem import Problem
from tulip_testbed.identification.planning.search import SearchState, round_count
from tulip_testbed.identification.planning.search_defaults import SOLVERS
from tulip_testbed.measurements import Measurements, PosturePlan

Show = Callable[[SearchState], None]


@dataclass(frozen=True)
class Job:
    """A search for a plan.

    Attributes:
        key: what a run that is to be taken up has to share with the interrupted one.
        rounds: how many it takes.
        run: from a state, or from the start; calls back after every round.
        best: the best plan of a state.
    """

    key: list[Any]
    rounds: int
    run: Callable[[Show, SearchState | None], PosturePlan]
    best: Callable[[SearchState], PosturePlan]


def plan_job(
    problem: Problem,
    goal: Objective,
    size: tuple[int, int, int],
    seed: int,
    solver: str = SOLVERS[0],
    counts: Mapping[str, int] | None = None,
    measured: Measurements | None = None,
) -> Job:
    """Search from a random start for a whole plan, or for the placements that tell most after measurements.

    Args:
        size: placements on both feet, postures on each, hops.
        solver: of the polish, one of `SOLVERS`.
        counts: number of postures on the "right" and on the "left" foot; None: none.
        measured: what was measured before; None: nothing.
    """
    placements, per, hops = size

    @cache
    def start() -> Start:
        return random_start(problem, goal, placements, per, seed, counts, measured)

    def run(show: Show, state: SearchState | None) -> PosturePlan:
        return optimize_plan(
            problem, goal, placements, per, seed, hops, show, state, solver, measured, start()
        )

    def best(state: SearchState) -> PosturePlan:
        return plan_from_state(problem, goal, replace(start(), state=state), seed, hops, solver, measured)

    key: list[Any] = [goal.name, *size, seed, problem.robot.model_hash, sha256(problem.robot.path), solver]
    key += [f"{number} {foot}" for foot, number in (counts or {}).items()]
    if measured is not None:
        key += [float(np.trace(measured_information(problem, measured))), len(measured)]
    return Job(key, round_count(goal, hops), run, best)
