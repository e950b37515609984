"""Search for an optimal plan: repaired random start, descent, exchange and a final polish.

Every round ends with a checkpoint. Its random numbers depend only on the seed and its own number, so that an
interrupted and resumed search ends with identical bits.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from tulip_testbed.base.errors import InputError, most_frequent
from tulip_testbed.base.result import Array, Documented
from tulip_testbed.identification.kinematics import roll_pitch_yaw
from tulip_testbed.identification.planning.blocks import (
    FEASIBLE,
    SHARED,
    Block,
    candidates,
    exchange,
    information,
)
from tulip_testbed.identification.planning.closed_chain import chain_at
from tulip_testbed.identification.planning.constraints import Evaluation, evaluate
from tulip_testbed.identification.planning.linear_steps import descend, merit, on_both_feet, repaired
from tulip_testbed.identification.planning.objectives import Objective, Smooth
from tulip_testbed.identification.planning.problem import PlanningProblem
from tulip_testbed.measurements import PosturePlan

WARM = 15  # linear steps for each of the smooth objectives at the start
STEPS = 12  # linear steps in a hop
POLISH, FINE = 30, 1.0  # linear steps from the best plan, and the weight of violations in them
LEAST_POOL = 3  # smallest number of candidates for an exchange
GAIN = 1e-6
ARRAYS = ("design", "angles", "best_design", "best_angles")
MOST = 100.0  # m or rad: beyond any posture
SAME = 1e-6  # relative difference of numbers that another machine computes


@dataclass(frozen=True, eq=False)
class SearchState(Documented):
    """State of the search after a number of rounds.

    Attributes:
        rounds: number of completed rounds.
        design, angles: current plan, which may be slightly infeasible, (m, 9) and (m, n).
        best_design, best_angles: best feasible plan.
        value: its objective.
        initial: objective of the repaired start.
        initial_condition: its condition number.
    """

    rounds: Annotated[int, Field(ge=0)]
    design: Array
    angles: Array
    best_design: Array
    best_angles: Array
    value: float
    initial: float
    initial_condition: float


def repair_start(
    problem: PlanningProblem, objective: Objective, drawn: PosturePlan, per: int, placements: int, source: str
) -> SearchState:
    """Repair the first placements of a random plan that can be made feasible, and begin the search there.

    Each placement has `per` postures.
    """
    angles = drawn.joint_angles
    design = design_of(problem, angles, drawn.swing_pose)
    tally, blocks = Counter[str](), list[Block]()
    for start in _blocks(design, angles, per):
        steps = on_both_feet(problem, per, per)
        evaluation = repaired(steps, evaluate(problem, start.design, start.angles))
        if not evaluation.reached.all():
            tally["out of reach"] += 1
        elif evaluation.inequalities.min() < -FEASIBLE:
            tally[evaluation.names[int(evaluation.inequalities.min(axis=0).argmin())]] += 1
        else:
            blocks.append(Block(evaluation.design, evaluation.chain.joint_angles))
        if len(blocks) == placements:
            break
    if len(blocks) < placements:
        raise InputError(
            f"{source}: found random postures on {tally.total()} of {len(design) // per} placements that "
            f"cannot be repaired to keep every constraint, expected {placements} that can; "
            f"blocked by {most_frequent(tally)}"
        )
    start = _evaluated(problem, blocks)
    value, condition = (of(information(start)) for of in (objective.value, objective.condition_number))
    design, angles = start.design, np.concatenate([block.angles for block in blocks])
    return SearchState(0, design, angles, design, angles, value, value, condition)


def round_count(objective: Objective, hops: int) -> int:
    return len(objective.smooth) + hops + 1


def search(
    problem: PlanningProblem, objective: Objective, state: SearchState, per: int, seed: int, hops: int
) -> Iterator[SearchState]:
    """Continue from a state and yield the state after every round.

    The rounds are a descent by each smooth objective in turn, then the hops, then a polish of the best plan.
    """
    stages, steps = objective.smooth, on_both_feet(problem, len(state.design), per)
    while state.rounds < round_count(objective, hops):
        k = state.rounds
        plan = evaluate(problem, state.design, state.angles)
        if k < len(stages):
            plan = descend(steps, plan, stages[k], WARM, objective.penalty)
        elif k < len(stages) + hops:
            last = len(stages) - 1
            smooth = stages[min(min(1, last) + (k - len(stages)) * 2 // max(hops, 1), last)]
            plan = _hop(problem, plan, per, smooth, objective.penalty, np.random.default_rng([seed, k]))
        else:
            best = evaluate(problem, state.best_design, state.best_angles)
            plan = descend(steps, best, stages[-1], POLISH, FINE)
        state = _kept(problem, objective, state, plan, per)
        yield state


def design_of(problem: PlanningProblem, angles: np.ndarray, swing: np.ndarray) -> np.ndarray:
    """Return the design variables of given postures, (m, 9)."""
    chain = chain_at(problem, angles)
    torso = roll_pitch_yaw(chain.rotations[:, problem.torso])
    return np.column_stack([chain.com, torso, swing])


def _kept(
    problem: PlanningProblem, objective: Objective, state: SearchState, plan: Evaluation, per: int
) -> SearchState:
    """Return the state after a round; only a feasible plan can become the best."""
    angles = plan.chain.joint_angles
    after = replace(state, rounds=state.rounds + 1, design=plan.design, angles=angles)
    if objective.value(information(plan)) > state.value:
        return after
    whole = repaired(on_both_feet(problem, len(angles), per), plan, objective.smooth[-1])
    value = objective.value(information(whole))
    if whole.reached.all() and whole.inequalities.min() >= -FEASIBLE and value < state.value:
        return replace(after, best_design=whole.design, best_angles=whole.chain.joint_angles, value=value)
    return after


def _hop(
    problem: PlanningProblem,
    plan: Evaluation,
    per: int,
    smooth: Smooth,
    penalty: float,
    rng: np.random.Generator,
) -> Evaluation:
    """Exchange postures of one placement, perhaps at another foot pose; keep the plan if it improves."""
    blocks = _blocks(plan.design, plan.chain.joint_angles, per)
    at = int(rng.integers(len(blocks)))
    block = blocks[at]
    every = plan.regressor.reshape(len(blocks), -1, plan.regressor.shape[-1])
    rest = np.delete(every, at, axis=0)
    rest = np.einsum("krp,krq->pq", rest, rest)
    moves = bool(rng.integers(2))
    swing = block.design[0, 6:]
    if moves:
        low, high = problem.ranges.swing.T
        swing = low + (high - low) * rng.random(3)
    pool = candidates(problem, swing, block, rng)
    stay = rng.permutation(per)[: 0 if moves else int(rng.integers(per))]
    if len(pool.design) < max(LEAST_POOL, per - len(stay)):
        return plan
    kept = Block(block.design[stay], block.angles[stay])
    blocks[at] = exchange(problem, kept, pool, rest, smooth, per)
    steps = on_both_feet(problem, len(plan.design), per)
    moved = descend(steps, _evaluated(problem, blocks), smooth, STEPS, penalty)
    return moved if merit(moved, smooth, penalty) < merit(plan, smooth, penalty) - GAIN else plan


def _blocks(design: np.ndarray, angles: np.ndarray, per: int) -> list[Block]:
    return [Block(design[i : i + per], angles[i : i + per]) for i in range(0, len(angles), per)]


def _evaluated(problem: PlanningProblem, blocks: list[Block]) -> Evaluation:
    return evaluate(
        problem, np.concatenate([b.design for b in blocks]), np.concatenate([b.angles for b in blocks])
    )


class StateError(InputError):
    """A state that the search which is to go on from it never left."""


def resumed(
    problem: PlanningProblem,
    objective: Objective,
    state: SearchState | None,
    start: SearchState,
    per: int,
    rounds: int,
) -> SearchState:
    """Return the state to go on from: the start, before the first round of the same search, if there is none.

    Raises:
        StateError: a plan of another size, one that breaks a constraint, or a number that is not its own.
    """
    if state is None:
        return start
    for name in ARRAYS:
        found, expected = getattr(state, name), getattr(start, name)
        if found.shape != expected.shape:
            raise StateError(f"{name}: found {found.shape}, expected {expected.shape} numbers")
        if not (np.abs(found) <= MOST).all():
            raise StateError(f"{name}: found a number beyond {MOST:g} [m, rad]")
    if state.rounds > rounds:
        raise StateError(f"rounds: found {state.rounds}, expected at most {rounds}")
    for name in ("design", "best_design"):
        swing = getattr(state, name)[:, SHARED].reshape(-1, per, 3)
        if np.ptp(swing, axis=1).max() > FEASIBLE:
            raise StateError(f"{name}: found several swing foot poses on one placement, expected one")
    best = evaluate(problem, state.best_design, state.best_angles)
    if not best.reached.all() or best.inequalities.min() < -2 * FEASIBLE:
        raise StateError("best_design: found a plan that breaks a constraint")
    expected = {
        "value": objective.value(information(best)),
        "initial": start.initial,
        "initial_condition": start.initial_condition,
    }
    for name, number in expected.items():
        if not np.isclose(getattr(state, name), number, rtol=SAME, atol=0.0):
            raise StateError(f"{name}: found {getattr(state, name):g}, expected {number:g}")
    return state
