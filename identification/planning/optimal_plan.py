"""Make an optimal plan for a robot, describe its margins, and add repeated postures."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.link_paths import with_free_paths
from tulip_testbed.identification.planning.blocks import information
from tulip_testbed.identification.planning.constraints import evaluate, quantity_of
from tulip_testbed.identification.planning.objectives import Objective, given
from tulip_testbed.identification.planning.one_foot import from_other_foot, single_support_margins
from tulip_testbed.identification.planning.one_foot_search import (
    POOL,
    OnOneFoot,
    appended_on_one_foot,
    from_pools,
    improved,
    random_pools,
    total,
)
from tulip_testbed.identification.planning.problem import PlanningProblem
from tulip_testbed.identification.planning.search import (
    SearchState,
    design_of,
    repair_start,
    resumed,
    round_count,
    search,
)
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements import Measurements, PosturePlan

# After measurements a plan gains less by its steps and ends the farther outside of its constraints; with the
# usual penalty the condition numbers became a tenth larger.
PENALTY_AFTER = 1.0
TURNS, SETTLED = 4, 1e-3  # rounds of improving one kind after the other; gain of one that is the last
SPARE = 2  # random placements drawn for each wanted one, since some cannot be repaired
GROUPS = {"joint": "joint limits", "torque": "torques"}  # by the first word of a constraint


@dataclass(frozen=True, eq=False)
class SearchTask:
    """A search for a plan, or for the placements that tell most after what was measured.

    The postures on both feet are optimised by `search`; then, if there are any on one foot, those of one kind
    given the others in turn, until that gains no more. All rows count alike.

    Attributes:
        problem: the robot and its constraints; its base parameters are those that all supports show together.
        objective: the objective to minimise.
        placements, per: number of placements on both feet, and of postures in each.
        seed: seed of the start and of the search.
        hops: number of rounds that exchange postures of one placement.
        counts: number of postures on the "right" and on the "left" foot, as far as any are wanted.
        measured: postures that were measured before; None: nothing was.
    """

    problem: PlanningProblem
    objective: Objective
    placements: int
    per: int
    seed: int
    hops: int
    counts: Mapping[str, int] = field(default_factory=dict)
    measured: Measurements | None = None

    @property
    def rounds(self) -> int:
        return round_count(self.objective, self.hops)

    @cached_property
    def goal(self) -> Objective:
        return after(self.problem, self.objective, self.measured)

    @cached_property
    def start(self) -> tuple[PosturePlan, SearchState, tuple[OnOneFoot, ...]]:
        """Draw random postures on both feet, and improve random ones on one foot that add most to them.

        The postures on both feet are returned with the state of their search.
        """
        problem, goal, seed = self.problem, self.goal, self.seed
        size = (SPARE * self.placements, self.per, seed)
        drawn = random_postures(problem.robot, problem.plate, *size, problem.ranges, margins=problem.margins)
        where = f"{problem.robot.path}: planning ranges, seed {seed}"
        state = repair_start(problem, goal, drawn, self.per, self.placements, where)
        drawn = drawn.take(np.arange(self.placements * self.per))
        drawn = replace(drawn, joint_angles=state.angles, swing_pose=state.design[:, 6:])
        single: list[OnOneFoot] = []
        if self.counts:
            both = _information(problem, state)
            pools = [*random_pools(problem, self.counts, seed)]
            single = from_pools(pools, self.counts, both, goal.smooth[0])
            first = both + total(single)
            single = improved(single, both, *goal.smooth)
            state = replace(
                state,
                value=goal.value(both + total(single)),
                initial=goal.value(first),
                initial_condition=goal.condition_number(first),
            )
        if not np.isfinite(state.initial_condition):
            before = 0 if self.measured is None else len(np.unique(self.measured.placement))
            raise InputError(
                f"{problem.robot.path}: found that postures on {self.placements + before} placements do not "
                f"determine {len(problem.value)} base parameters, expected more placements"
            )
        return drawn, state, tuple(single)

    def run(
        self, progress: Callable[[SearchState], None] = lambda state: None, state: SearchState | None = None
    ) -> PosturePlan:
        """Search, or go on from the state of an interrupted search with the same settings.

        The state of the postures on both feet after every round goes to `progress`, which may raise
        KeyboardInterrupt.
        """
        problem, (_, begun, single) = self.problem, self.start
        whole = given(self.goal, total(single)) if single else self.goal
        state = first = resumed(problem, whole, state, begun, self.per, self.rounds)
        for state in search(problem, whole, first, self.per, self.seed, self.hops):
            progress(state)
        return self.plan_of(*(self._in_turn(state, single) if single else (state, ())))

    def _in_turn(
        self, state: SearchState, single: tuple[OnOneFoot, ...]
    ) -> tuple[SearchState, tuple[OnOneFoot, ...]]:
        problem, goal = self.problem, self.goal
        smooth, both = goal.smooth[-1], _information(problem, state)
        for _ in range(TURNS):
            before = smooth(both + total(single))[0]
            single = tuple(improved(single, both, smooth))
            whole = given(goal, total(single))
            state = replace(state, rounds=self.rounds - 1, value=whole.value(both))
            (state,) = search(problem, whole, state, self.per, self.seed, self.hops)
            both = _information(problem, state)
            if before - smooth(both + total(single))[0] < SETTLED:
                break
        return state, single

    def plan_of(self, state: SearchState, single: Sequence[OnOneFoot] | None = None) -> PosturePlan:
        """Return the best plan of a state, with the settings that made it; numbered after what was measured.

        Postures on one foot, those of the start if None, come behind the others, on placements of their own.
        """
        problem, measured, (drawn, _, first) = self.problem, self.measured, self.start
        made = {
            "objective": self.objective.name,
            "seed": self.seed,
            "placements": self.placements,
            "per_placement": self.per,
            "solver": "sequential linear programming, exchange",
            "rounds": state.rounds,
            "rounds_planned": self.rounds,
            "initial_condition_number": state.initial_condition,
            "initial_objective": state.initial,
            "final_objective": state.value,
            "ranges": dataclasses.asdict(problem.ranges),
            "margins": dataclasses.asdict(problem.margins),
        }
        if measured is not None:
            made["measured_objective"] = self.objective.value(measured_information(problem, measured))
            made["after"] = {"postures": len(measured), "placements": len(np.unique(measured.placement))}
        best = evaluate(problem, state.best_design, state.best_angles)
        swing = state.best_design[:, 6:]
        angles = best.chain.joint_angles
        plan = replace(drawn, joint_angles=angles, swing_pose=swing, made=made, torques=best.torque)
        plan = with_free_paths(problem.robot, problem.pairs, plan)
        if single := first if single is None else single:
            counts = {own.support: len(own.angles) for own in single}
            on_one_foot = {**counts, "pool": POOL, "lifted": problem.margins.lifted}
            plan = replace(plan, made=plan.made | {"on_one_foot": on_one_foot})
        for own in single:
            plan = appended_on_one_foot(plan, own)
        if measured is None:
            return plan
        return replace(
            plan,
            placement=plan.placement + int(measured.placement.max()),
            posture=plan.posture + int(measured.posture.max()),
        )


def _information(problem: PlanningProblem, state: SearchState) -> np.ndarray:
    return information(evaluate(problem, state.best_design, state.best_angles))


def after(problem: PlanningProblem, objective: Objective, measured: Measurements | None) -> Objective:
    """Return the objective of further postures; information adds up over postures."""
    if measured is None:
        return objective
    return replace(given(objective, measured_information(problem, measured)), penalty=PENALTY_AFTER)


def measured_information(problem: PlanningProblem, measurements: Measurements) -> np.ndarray:
    """Compute M = H'H of the measured postures at their measured angles, (p, p)."""
    rows = stacked_regressor(problem.parameters, measurements.joint_angles, measurements.support)
    return rows.T @ rows


def smallest_margins(problem: PlanningProblem, plan: PosturePlan) -> dict[str, dict[str, Any]]:
    """Return the smallest margin of every constraint and the posture where it occurs.

    Zero means that the constraint is just kept with all its margins; a negative value is infeasible.
    """
    least: dict[str, dict[str, Any]] = {}

    def compare(group: str, name: str, values: np.ndarray, posture: np.ndarray) -> None:
        row = int(values.argmin())
        if group not in least or values[row] < least[group]["value"]:
            _, unit, _ = quantity_of(name)
            place = {"posture": int(posture[row]), "at": name}
            least[group] = {"value": float(values[row]), "unit": unit, **place}

    for support in ("double", "right", "left"):
        part = plan.take(plan.support == support)
        if not len(part):
            continue
        if support == "double":
            design = design_of(problem, part.joint_angles, part.swing_pose)
            found = evaluate(problem, design, part.joint_angles)
            kept = found.inequalities + problem.margins.rounding
            for name, values in zip(found.names, kept.T, strict=True):
                scale, _, size = quantity_of(name)
                compare(GROUPS.get(name.split()[0], name), name, values * (scale * size), part.posture)
            continue
        own = problem if support == "right" else from_other_foot(problem)
        for name, values in single_support_margins(own, part.joint_angles, part.swing_pose).items():
            compare(f"{support} foot: {name}", name, values, part.posture)
    return least


def with_repeats(plan: PosturePlan, count: int, seed: int) -> PosturePlan:
    """Return the plan with `count` postures repeated under the same number.

    Half of them (rounded up) are repeated at the end of their own placement; their pure error is that of
    readings and approach. Each of the others is repeated on a placement of its own with the same foot pose,
    where the plates are laid and recorded again; its pure error includes that of the placement.
    """
    order = np.random.default_rng([seed, count, 2]).permutation(len(plan))
    # A repeat of a placement's last posture would follow at once, without a new approach.
    last = np.append(plan.placement[1:] != plan.placement[:-1], True)
    within = np.sort(order[~last[order]][: (count + 1) // 2])
    anew = np.sort(order[~np.isin(order, within)][: count - len(within)])
    rows: list[int] = []
    for number in dict.fromkeys(plan.placement.tolist()):
        there = np.flatnonzero(plan.placement == number)
        rows += [*there.tolist(), *within[np.isin(within, there)].tolist()]
    placement = np.append(plan.placement[rows], plan.placement.max() + 1 + np.arange(len(anew)))
    chosen = np.append(rows, anew).astype(int)
    repeats = {"within_placement": plan.posture[within].tolist(), "placed_anew": plan.posture[anew].tolist()}
    return replace(plan.take(chosen), placement=placement, made=plan.made | {"repeats": repeats})
