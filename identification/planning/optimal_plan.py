"""Make an optimal plan for a robot, describe its margins, and add repeated postures."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError, look_up
from tulip_testbed.identification.planning.constraints import (
    ANGLE,
    FORCE,
    LENGTH,
    TORQUE,
    evaluate,
    inequality_names,
)
from tulip_testbed.identification.planning.objectives import OBJECTIVES, Objective, given, objectives
from tulip_testbed.identification.planning.path_order import with_free_paths
from tulip_testbed.identification.planning.problem import Problem
from tulip_testbed.identification.planning.search import (
    SearchState,
    design_of,
    repair_start,
    resumed,
    round_count,
    search,
)
from tulip_testbed.identification.planning.search_defaults import HOPS, SOLVERS
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements import Measurements, PosturePlan

# After measurements a plan gains less by its steps and ends the farther outside of its constraints; with the
# usual penalty the condition numbers became a tenth larger.
PENALTY_AFTER = 1.0
SPARE = 2  # random placements drawn for each wanted one, since some cannot be repaired
UNITS = {  # of a margin, by the first word of its constraint: unit, and size of an inequality of one
    "joint": ("deg", float(np.rad2deg(ANGLE))),
    "cell": ("N", FORCE),
    "foot": ("N", FORCE),
    "torque": ("% of limit", 100 * TORQUE),
}
MILLIMETRES = ("mm", 1e3 * LENGTH)


def objective_by_name(problem: Problem, name: str, sigma: float) -> Objective:
    """Return the objective of `OBJECTIVES` with this name.

    Raises:
        InputError: the name is unknown; the message lists the valid ones.
    """
    look_up("objective", name, OBJECTIVES, "objective")
    return objectives(problem.nominal, sigma)[name]


def initial_state(
    problem: Problem, objective: Objective, placements: int, per: int, seed: int
) -> tuple[PosturePlan, SearchState]:
    """Draw a random start of the search and repair it.

    Raises:
        InputError: no posture is feasible, or too few can be repaired to keep the margins.
    """
    drawn = random_postures(
        problem.robot,
        problem.plate,
        SPARE * placements,
        per,
        seed,
        problem.ranges,
        margins=problem.margins,
    )
    where = f"{problem.robot.path}: planning ranges, seed {seed}"
    state = repair_start(problem, objective, drawn.joint_angles, drawn.swing_pose, per, placements, where)
    count = placements * per
    drawn = dataclasses.replace(
        drawn,
        joint_angles=state.angles,
        posture=drawn.posture[:count],
        placement=drawn.placement[:count],
        support=drawn.support[:count],
        swing_pose=state.design[:, 6:],
    )
    return drawn, state


def require_identifiable(problem: Problem, state: SearchState, placements: int) -> None:
    """Refuse a start whose postures do not determine the parameters, as with one or two placements.

    Args:
        problem: the robot.
        state: the start of the search.
        placements: number of placements, measured ones included.

    Raises:
        InputError: the start's information is singular.
    """
    if not np.isfinite(state.initial_condition):
        raise InputError(
            f"{problem.robot.path}: found that postures on {placements} placements do not determine "
            f"{len(problem.nominal)} base parameters, expected more placements"
        )


def optimize_plan(
    problem: Problem,
    objective: Objective,
    placements: int,
    per: int,
    seed: int,
    hops: int = HOPS,
    progress: Callable[[SearchState], None] = lambda state: None,
    state: SearchState | None = None,
    solver: str = SOLVERS[0],
    measured: Measurements | None = None,
) -> PosturePlan:
    """Optimise a plan from its own random start, or the placements that tell most after what was measured.

    Args:
        problem: the robot and its constraints.
        objective: the objective to minimise.
        placements, per: number of placements, and of postures in each.
        seed: seed of the start and of the search.
        hops: number of rounds that exchange postures of one placement.
        progress: called with the state after every round; may raise KeyboardInterrupt.
        state: state of an interrupted search with the same arguments, to continue from.
        solver: solver of the last round, one of `SOLVERS`.
        measured: postures that were measured before; None: nothing was.

    Raises:
        InputError: as `initial_state`, `require_identifiable` and `resumed`.
    """
    goal = after(problem, objective, measured)
    drawn, start = initial_state(problem, goal, placements, per, seed)
    before = 0 if measured is None else len(np.unique(measured.placement))
    require_identifiable(problem, start, placements + before)
    state = resumed(problem, goal, state, start, per, round_count(objective, hops))
    for found in search(problem, goal, state, per, seed, hops, solver):
        state = found
        progress(found)
    return plan_from_state(problem, objective, drawn, state, seed, hops, solver, measured)


def after(problem: Problem, objective: Objective, measured: Measurements | None) -> Objective:
    """Return the objective of further postures; information adds up over postures."""
    if measured is None:
        return objective
    return dataclasses.replace(
        given(objective, measured_information(problem, measured)), penalty=PENALTY_AFTER
    )


def measured_information(problem: Problem, measurements: Measurements) -> np.ndarray:
    """Compute M = H'H of the measured postures at their measured angles, (p, p)."""
    rows = stacked_regressor(problem.parameters, measurements.joint_angles, measurements.support)
    return rows.T @ rows


def plan_from_state(
    problem: Problem,
    objective: Objective,
    drawn: PosturePlan,
    state: SearchState,
    seed: int,
    hops: int,
    solver: str = SOLVERS[0],
    measured: Measurements | None = None,
) -> PosturePlan:
    """Return the best plan of a state, with the settings that made it; numbered after what was measured."""
    made = {
        "objective": objective.name,
        "seed": seed,
        "placements": len(np.unique(drawn.placement)),
        "per_placement": int((drawn.placement == drawn.placement[0]).sum()),
        "solver": f"sequential linear programming, exchange, {solver}",
        "rounds": state.rounds,
        "rounds_planned": round_count(objective, hops),
        "initial_condition_number": state.initial_condition,
        "initial_objective": state.initial,
        "final_objective": state.value,
        "ranges": dataclasses.asdict(problem.ranges),
        "margins": dataclasses.asdict(problem.margins),
    }
    if measured is not None:
        made["measured_objective"] = objective.value(measured_information(problem, measured))
        made["after"] = {"postures": len(measured), "placements": len(np.unique(measured.placement))}
    best = evaluate(problem, state.best_design, state.best_angles)
    plan = dataclasses.replace(
        drawn,
        joint_angles=best.chain.angles,
        swing_pose=state.best_design[:, 6:],
        made=made,
        torques=best.torque,
    )
    plan = with_free_paths(problem, plan)
    if measured is None:
        return plan
    return dataclasses.replace(
        plan,
        placement=plan.placement + int(measured.placement.max()),
        posture=plan.posture + int(measured.posture.max()),
    )


def smallest_margins(problem: Problem, plan: PosturePlan) -> dict[str, dict[str, Any]]:
    """Return the smallest margin of every constraint and the posture where it occurs.

    Zero means that the constraint is just kept with all its margins; a negative value is infeasible.
    """
    design = design_of(problem, plan.joint_angles, plan.swing_pose)
    found = evaluate(problem, design, plan.joint_angles)
    names = inequality_names(problem)
    least: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(names):
        first = name.split()[0]
        group = {"joint": "joint limits", "torque": "torques"}.get(first, name)
        unit, size = UNITS.get(first, MILLIMETRES)
        values = (found.inequalities[:, k] + problem.margins.rounding) * size
        row = int(values.argmin())
        if group not in least or values[row] < least[group]["value"]:
            least[group] = {
                "value": float(values[row]),
                "unit": unit,
                "posture": int(plan.posture[row]),
                "at": name,
            }
    return least


def with_repeats(plan: PosturePlan, count: int, seed: int) -> PosturePlan:
    """Return the plan with `count` postures repeated under the same number.

    Half of them (rounded up) are repeated at the end of their own placement; their pure error is that of
    readings and approach. Each of the others is repeated on a placement of its own with the same foot pose,
    where the plates are laid and recorded again; its pure error includes that of the placement.

    Args:
        plan: the plan.
        count: number of repeats, at most the number of postures.
        seed: seed of the choice.
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
    return dataclasses.replace(plan.take(chosen), placement=placement, made=plan.made | {"repeats": repeats})
