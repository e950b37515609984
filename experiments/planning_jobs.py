"""The searches for plans as jobs that can be carried out from any of their states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from tulip_testbed.base.files import sha256
from tulip_testbed.identification.planning.mixed_plan import (
    MixedStart,
    mixed_plan_from_state,
    mixed_start,
    optimize_mixed_plan,
)
from tulip_testbed.identification.planning.objectives import Objective
from tulip_testbed.identification.planning.optimal_plan import (
    after,
    initial_state,
    measured_information,
    optimize_plan,
    plan_from_state,
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


def trial_job(
    problem: Problem,
    goal: Objective,
    size: tuple[int, int, int],
    seed: int,
    solver: str = SOLVERS[0],
    measured: Measurements | None = None,
) -> Job:
    """Search from a random start for a whole plan, or for the placements that tell most after measurements.

    Args:
        size: placements, postures on each, hops.
        solver: of the polish, one of `SOLVERS`.
        measured: what was measured before; None: nothing.
    """
    placements, per, hops = size

    def run(show: Show, state: SearchState | None) -> PosturePlan:
        return optimize_plan(problem, goal, placements, per, seed, hops, show, state, solver, measured)

    def best(state: SearchState) -> PosturePlan:
        drawn, _ = initial_state(problem, after(problem, goal, measured), placements, per, seed)
        return plan_from_state(problem, goal, drawn, state, seed, hops, solver, measured)

    key = [*_key(problem, goal, size, seed), solver]
    if measured is not None:
        key += [float(np.trace(measured_information(problem, measured))), len(measured)]
    return Job(key, round_count(goal, hops), run, best)


def mixed_job(
    problem: Problem,
    goal: Objective,
    size: tuple[int, int, int],
    counts: dict[str, int],
    seed: int,
    solver: str = SOLVERS[0],
) -> Job:
    """Search for a plan on both feet and on one from a random start; arguments as `trial_job`.

    Args:
        counts: number of postures on the "right" and on the "left" foot.
    """
    placements, per, hops = size

    @cache
    def start() -> MixedStart:
        return mixed_start(problem, goal, placements, per, counts, seed)

    def run(show: Show, state: SearchState | None) -> PosturePlan:
        return optimize_mixed_plan(problem, goal, start(), seed, hops, show, state, solver)

    def best(state: SearchState) -> PosturePlan:
        return mixed_plan_from_state(problem, goal, replace(start(), state=state), seed, hops, solver)

    key = [*_key(problem, goal, size, seed), solver, *(f"{n} {foot}" for foot, n in counts.items())]
    return Job(key, round_count(goal, hops), run, best)


def _key(problem: Problem, goal: Objective, size: tuple[int, int, int], seed: int) -> list[Any]:
    return [goal.name, *size, seed, problem.robot.model_hash, sha256(problem.robot.path)]
