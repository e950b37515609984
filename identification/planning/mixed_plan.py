"""Optimise postures on both feet, on the right foot and on the left foot together.

The information of a plan is the sum over its rows, on one foot or on two. So the rows of one kind are
improved given the information of the others, in turn, until that gains no more. All rows count alike.

Every posture on one foot is put down by itself, on a placement of its own. Optimal ones use what torque the
drives have, and on the way from one to the next, in the laboratory's 2 s, the standing ankle's drive comes to
its limit even between near ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.identification.planning.blocks import information
from tulip_testbed.identification.planning.closed_chain import chain_at, open_chain_torques
from tulip_testbed.identification.planning.constraints import evaluate
from tulip_testbed.identification.planning.objectives import (
    Objective,
    Smooth,
    condition_number,
    given,
    shifted,
)
from tulip_testbed.identification.planning.one_foot import from_other_foot
from tulip_testbed.identification.planning.one_foot_steps import descend_on_one_foot
from tulip_testbed.identification.planning.optimal_plan import (
    initial_state,
    plan_from_state,
    require_identifiable,
)
from tulip_testbed.identification.planning.problem import Problem
from tulip_testbed.identification.planning.search import SearchState, resumed, round_count, search
from tulip_testbed.identification.planning.search_defaults import HOPS, SOLVERS
from tulip_testbed.identification.planning.single_support import feasible_pool
from tulip_testbed.measurements import PosturePlan

POOL = 3  # random postures for each wanted one on one foot
PASSES = 3  # exchanges over all postures on one foot
STEPS = 40  # linear steps of the postures on one foot in a round
TURNS, SETTLED = 4, 1e-3  # rounds of improving one kind after the other; gain of one that is the last


@dataclass(frozen=True)
class OnOneFoot:
    """Postures on one foot.

    Attributes:
        support: "right" or "left".
        problem: constraints and regressor of standing on this foot.
        swing: pose of the other foot's board, (3,) [m, m, rad].
        angles: joint angles, (k, n) [rad].
    """

    support: str
    problem: Problem
    swing: np.ndarray
    angles: np.ndarray

    @property
    def information(self) -> np.ndarray:
        """Return M = H'H of the postures, (p, p)."""
        return self.each.sum(axis=0)

    @property
    def each(self) -> np.ndarray:
        """Return the information of each posture, (k, p, p)."""
        rows = self.problem.parameters.regressor(self.angles)
        return rows.mT @ rows


@dataclass(frozen=True)
class MixedStart:
    """Start of the search.

    Attributes:
        drawn: random postures on both feet.
        state: state of their search.
        single: postures on each foot.
    """

    drawn: PosturePlan
    state: SearchState
    single: list[OnOneFoot]

    @property
    def per(self) -> int:
        """Return the number of postures on a placement."""
        return int((self.drawn.placement == self.drawn.placement[0]).sum())


def optimize_mixed_plan(
    problem: Problem,
    objective: Objective,
    start: MixedStart,
    seed: int,
    hops: int = HOPS,
    progress: Callable[[SearchState], None] = lambda state: None,
    state: SearchState | None = None,
    solver: str = SOLVERS[0],
) -> PosturePlan:
    """Optimise a plan on both feet and on one: those on both feet by `search`, then each kind in turn.

    Args:
        problem: planning problem with the base parameters that the supports show together.
        objective: the objective of the whole plan.
        start: see `mixed_start`.
        seed: seed of the search.
        hops: number of rounds that exchange postures on both feet.
        progress: called with the state of the postures on both feet after every round of `search`; may raise
            KeyboardInterrupt.
        state: state of an interrupted search with the same arguments, to continue from.
        solver: solver of the last round of `search`, one of `SOLVERS`.

    Raises:
        StateError: see `resumed`.
    """
    single, per = start.single, start.per
    goal = given(objective, total(single))
    state = resumed(problem, goal, state, start.state, per, round_count(objective, hops))
    for found in search(problem, goal, state, per, seed, hops, solver):
        state = found
        progress(found)
    smooth, rounds = objective.smooth[-1], round_count(objective, hops)
    both = _both(problem, state)
    for _ in range(TURNS):
        before = smooth(both + total(single))[0]
        single = improved(single, both, smooth)
        goal = given(objective, total(single))
        (state,) = search(
            problem, goal, replace(state, rounds=rounds - 1, value=goal.value(both)), per, seed, hops
        )
        both = _both(problem, state)
        if before - smooth(both + total(single))[0] < SETTLED:
            break
    found = replace(start, state=state, single=single)
    return mixed_plan_from_state(problem, objective, found, seed, hops, solver)


def mixed_start(
    problem: Problem, objective: Objective, placements: int, per: int, counts: dict[str, int], seed: int
) -> MixedStart:
    """Draw random postures on both feet, and improve random ones on one foot that add most to them.

    Args:
        problem: planning problem with the base parameters that the supports show together.
        objective: the objective of the whole plan.
        placements, per: number of placements on both feet, and of postures in each.
        counts: number of postures on the "right" and on the "left" foot, as far as any are wanted.
        seed: seed of the draws.

    Raises:
        InputError: too few random postures are feasible, or these do not determine the parameters.
    """
    drawn, state = initial_state(problem, objective, placements, per, seed)
    rest, smooth = _both(problem, state), objective.smooth
    pools = random_pools(problem, counts, seed)
    single = from_pools(pools, counts, rest, smooth[0])
    first = rest + total(single)
    single = improved(single, rest, *smooth)
    state = replace(
        state,
        value=objective.value(rest + total(single)),
        initial=objective.value(first),
        initial_condition=condition_number(first),
    )
    require_identifiable(problem, state, placements)
    return MixedStart(drawn, state, single)


def random_pools(problem: Problem, counts: dict[str, int], seed: int, times: int = POOL) -> list[OnOneFoot]:
    """Draw random feasible postures on each foot, `times` as many as are wanted if draws suffice.

    The lifted foot's board lies as far to its side as the ranges allow, so that both lie central to their
    feet.
    """
    pools = []
    for number, (support, count) in enumerate(counts.items()):
        own = problem if support == "right" else from_other_foot(problem)
        swing, rng = board_pose(own), np.random.default_rng([seed, number, 3])
        pools.append(OnOneFoot(support, own, swing, feasible_pool(own, swing, count, rng, times)))
    return pools


def board_pose(problem: Problem) -> np.ndarray:
    """Return the pose of the lifted foot's board: its middle ahead, its farthest to the side, (3,)."""
    x, y, yaw = problem.ranges.swing_x, problem.ranges.swing_y, problem.ranges.swing_yaw
    return np.array([sum(x) / 2, max(y, key=abs), np.clip(0.0, *yaw)])


def from_pools(
    pools: list[OnOneFoot], counts: dict[str, int], rest: np.ndarray, smooth: Smooth
) -> list[OnOneFoot]:
    """Choose from pools the postures that minimise a function of M, by exchange (Fedorov 1972).

    Args:
        pools: candidates on each foot.
        counts: number of postures to choose on each.
        rest: information of the postures on both feet, (p, p).
        smooth: function of M and its gradient.
    """
    every = [pool.each for pool in pools]
    chosen = [list(range(counts[pool.support])) for pool in pools]
    now = rest + sum(each[rows].sum(axis=0) for each, rows in zip(every, chosen, strict=True))
    value = smooth(now)[0]
    for _ in range(PASSES):
        before = value
        for each, rows in zip(every, chosen, strict=True):
            for place in range(len(rows)):
                free = [k for k in range(len(each)) if k not in rows]
                base = now - each[rows[place]]
                values = [smooth(base + each[k])[0] for k in free]
                if values and min(values) < value:
                    rows[place] = free[int(np.argmin(values))]
                    now, value = base + each[rows[place]], min(values)
        if value == before:
            break
    return [replace(pool, angles=pool.angles[rows]) for pool, rows in zip(pools, chosen, strict=True)]


def improved(single: list[OnOneFoot], both: np.ndarray, *stages: Smooth) -> list[OnOneFoot]:
    """Improve the postures on one foot, one foot after the other, by each function of M in turn.

    Args:
        single: feasible postures on each foot.
        both: information of the postures on both feet, (p, p).
        stages: functions of M and their gradients.
    """
    single = list(single)
    for smooth in stages:
        for k, one in enumerate(single):
            rest = both + total(single) - one.information
            angles = descend_on_one_foot(one.problem, one.angles, one.swing, shifted(smooth, rest), STEPS)
            single[k] = replace(one, angles=angles)
    return single


def total(single: list[OnOneFoot]) -> np.ndarray:
    """Return the information of all postures on one foot, (p, p)."""
    return np.sum([one.information for one in single], axis=0)


def mixed_plan_from_state(
    problem: Problem,
    objective: Objective,
    found: MixedStart,
    seed: int,
    hops: int,
    solver: str = SOLVERS[0],
) -> PosturePlan:
    """Return the best plan of a state with the postures on one foot behind it, on placements of their own."""
    goal = given(objective, total(found.single))
    plan = plan_from_state(problem, goal, found.drawn, found.state, seed, hops, solver)
    counts = {one.support: len(one.angles) for one in found.single}
    made = {**counts, "pool": POOL, "lifted": problem.margins.lifted}
    plan = replace(plan, made=plan.made | {"on_one_foot": made})
    for one in found.single:
        number = 1 + np.arange(len(one.angles))
        torques = open_chain_torques(one.problem, chain_at(one.problem, one.angles))
        plan = replace(
            plan,
            joint_angles=np.concatenate([plan.joint_angles, one.angles]),
            posture=np.append(plan.posture, plan.posture.max() + number),
            placement=np.append(plan.placement, plan.placement.max() + number),
            support=np.append(plan.support, np.full(len(number), one.support)),
            swing_pose=np.concatenate([plan.swing_pose, np.tile(one.swing, (len(number), 1))]),
            torques=np.concatenate([plan.feed_forward, torques]),
        )
    return plan


def _both(problem: Problem, state: SearchState) -> np.ndarray:
    return information(evaluate(problem, state.best_design, state.best_angles))
