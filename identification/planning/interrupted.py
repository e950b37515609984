"""Go on from the state of an interrupted search only if this very search may have left it."""

from __future__ import annotations

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.planning.blocks import FEASIBLE, SHARED, information
from tulip_testbed.identification.planning.constraints import evaluate
from tulip_testbed.identification.planning.objectives import Objective
from tulip_testbed.identification.planning.problem import Problem
from tulip_testbed.identification.planning.search import SearchState

ARRAYS = ("design", "angles", "best_design", "best_angles")
SAME = 1e-6  # relative difference of numbers that another machine computes


class StateError(InputError):
    """A state that the search which is to go on from it never left."""


def resumed(
    problem: Problem,
    objective: Objective,
    state: SearchState | None,
    start: SearchState,
    per: int,
    rounds: int,
    measured: np.ndarray | None = None,
) -> SearchState:
    """Return the state to go on from: the start if there is none.

    Args:
        start: state of the same search before its first round.
        per: number of postures in a placement.
        rounds: how many the search takes.
        measured: information of the measured postures, (p, p); None: nothing was measured.

    Raises:
        StateError: a plan of another size, one that breaks a constraint, or a number that is not its own.
    """
    if state is None:
        return start
    for name in ARRAYS:
        found, expected = getattr(state, name), getattr(start, name)
        if found.shape != expected.shape:
            raise StateError(f"{name}: found {found.shape}, expected {expected.shape} numbers")
    if state.rounds > rounds:
        raise StateError(f"rounds: found {state.rounds}, expected at most {rounds}")
    for name in ("design", "best_design"):
        swing = getattr(state, name)[:, SHARED].reshape(-1, per, 3)
        if np.ptp(swing, axis=1).max() > FEASIBLE:
            raise StateError(f"{name}: found several swing foot poses on one placement, expected one")
    best = evaluate(problem, state.best_design, state.best_angles)
    if not best.reached.all() or best.inequalities.min() < -2 * FEASIBLE:
        raise StateError("best_design: found a plan that breaks a constraint")
    known = information(best) if measured is None else measured + information(best)
    expected = {
        "value": objective.value(known),
        "initial": start.initial,
        "initial_condition": start.initial_condition,
    }
    for name, number in expected.items():
        if not np.isclose(getattr(state, name), number, rtol=SAME, atol=0.0):
            raise StateError(f"{name}: found {getattr(state, name):g}, expected {number:g}")
    return state
