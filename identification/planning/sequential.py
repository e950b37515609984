"""Plan the next placements given measured ones, by exchange and SLSQP on one of them at a time.

Information adds up over postures, so that the measurements enter as a constant matrix; the rest is the
problem of `search` with fewer placements.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from tulip_testbed.identification.planning.blocks import Block, improve, information
from tulip_testbed.identification.planning.constraints import evaluate
from tulip_testbed.identification.planning.exchange import candidates, exchange
from tulip_testbed.identification.planning.objectives import Objective, condition_number
from tulip_testbed.identification.planning.optimal_plan import (
    initial_state,
    plan_from_state,
    require_identifiable,
)
from tulip_testbed.identification.planning.problem import Problem
from tulip_testbed.identification.planning.search import POLISH, SearchState, resumed
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements import Measurements, PosturePlan

STEPS = 8  # of SLSQP after an exchange


def measured_information(problem: Problem, measurements: Measurements) -> np.ndarray:
    """Compute M = H'H of the measured postures at their measured angles, (p, p)."""
    rows = stacked_regressor(problem.parameters, measurements.joint_angles, measurements.support)
    return rows.T @ rows


def initial_next_state(
    problem: Problem, objective: Objective, measured: np.ndarray, placements: int, per: int, seed: int
) -> tuple[PosturePlan, SearchState]:
    """Draw random placements and repair them, as the start of the search.

    Args:
        problem: the robot and its constraints.
        objective: the objective.
        measured: information of the measured postures, (p, p).
        placements, per: number of placements, and of postures in each.
        seed: seed of the draws.

    Raises:
        InputError: no posture is feasible, or too few can be repaired to keep the margins.
    """
    drawn, state = initial_state(problem, objective, placements, per, seed)
    start = measured + information(evaluate(problem, state.design, state.angles))
    value = objective.value(start)
    return drawn, replace(state, value=value, initial=value, initial_condition=condition_number(start))


def next_round_count(placements: int, hops: int) -> int:
    """Return the number of rounds of `search_next`."""
    return hops + placements


def search_next(
    problem: Problem,
    objective: Objective,
    measured: np.ndarray,
    state: SearchState,
    per: int,
    seed: int,
    hops: int,
) -> Iterator[SearchState]:
    """Continue from a state and yield the state after every round.

    A hop exchanges postures of one placement for random ones, perhaps at another foot pose, and improves the
    placement by SLSQP; it is kept if the objective decreases. At the end every placement is polished once.
    """
    count = len(state.best_design) // per
    while state.rounds < next_round_count(count, hops):
        k = state.rounds
        blocks = [
            Block(state.best_design[i : i + per], state.best_angles[i : i + per])
            for i in range(0, count * per, per)
        ]
        rng = np.random.default_rng([seed, k])
        at = k % count
        parts = [information(evaluate(problem, b.design, b.angles)) for b in blocks]
        rest = measured + np.sum([part for j, part in enumerate(parts) if j != at], axis=0)
        stage = objective.smooth[min(k * len(objective.smooth) // max(hops, 1), len(objective.smooth) - 1)]
        block = blocks[at]
        if k < hops:
            r = problem.ranges
            low, high = np.array([r.swing_x, r.swing_y, r.swing_yaw]).T
            moves = bool(rng.integers(2))
            swing = low + (high - low) * rng.random(3) if moves else block.design[0, 6:]
            pool = candidates(problem, swing, block, rng)
            stay = Block(block.design[:0], block.angles[:0]) if moves else block
            if len(pool.design) >= per:
                block = exchange(problem, stay, pool, rest, stage, per)
        block = improve(problem, block, rest, stage, STEPS if k < hops else POLISH)
        found = evaluate(problem, block.design, block.angles)
        value = objective.value(rest + information(found))
        state = replace(state, rounds=k + 1)
        if value < state.value:
            blocks[at] = Block(block.design, found.chain.angles)
            design = np.concatenate([b.design for b in blocks])
            angles = np.concatenate([b.angles for b in blocks])
            state = replace(
                state, design=design, angles=angles, best_design=design, best_angles=angles, value=value
            )
        yield state


def optimize_next_placements(
    problem: Problem,
    objective: Objective,
    measurements: Measurements,
    placements: int,
    per: int,
    seed: int,
    hops: int,
    progress: Callable[[SearchState], None] = lambda state: None,
    state: SearchState | None = None,
) -> PosturePlan:
    """Optimise the next placements from a random start.

    Args:
        problem: the robot and its constraints.
        objective: the objective.
        measurements: the measured postures.
        placements, per: number of placements, and of postures in each.
        seed: seed of the start and of the search.
        hops: number of rounds that exchange postures.
        progress: called with the state after every round; may raise KeyboardInterrupt.
        state: state of an interrupted search with the same arguments, to continue from.

    Raises:
        InputError: as `initial_next_state`, `require_identifiable` and `resumed`.
    """
    measured = measured_information(problem, measurements)
    drawn, start = initial_next_state(problem, objective, measured, placements, per, seed)
    require_identifiable(problem, start, placements + len(np.unique(measurements.placement)))
    rounds = next_round_count(placements, hops)
    state = resumed(problem, objective, state, start, per, rounds, measured)
    for found in search_next(problem, objective, measured, state, per, seed, hops):
        state = found
        progress(found)
    return next_plan_from_state(problem, objective, drawn, state, measurements, seed, hops)


def next_plan_from_state(
    problem: Problem,
    objective: Objective,
    drawn: PosturePlan,
    state: SearchState,
    measurements: Measurements,
    seed: int,
    hops: int,
) -> PosturePlan:
    """Return the best placements of a state, numbered after the measured placements and postures."""
    plan = plan_from_state(problem, objective, drawn, state, seed, hops)
    measured = measured_information(problem, measurements)
    made = plan.made | {
        "solver": "exchange, slsqp, one placement at a time",
        "rounds_planned": next_round_count(plan.made["placements"], hops),
        "measured_objective": objective.value(measured),
        "after": {
            "postures": len(measurements),
            "placements": len(np.unique(measurements.placement)),
        },
    }
    return dataclasses.replace(
        plan,
        placement=plan.placement + int(measurements.placement.max()),
        posture=plan.posture + int(measurements.posture.max()),
        made=made,
    )
