"""Where in its plan a watch is: the row that a posture is, a new placement or stance, what comes next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.experiments.watching.day_model import STANCE, DayModel
from tulip_testbed.experiments.watching.recursive_estimate import OF_PLACEMENT
from tulip_testbed.experiments.watching.watch_state import AGAIN, GAPS, MEASURED, OPEN, WatchState
from tulip_testbed.identification.observation import LONG_GAP
from tulip_testbed.measurements import Measurements

LEAST_GAPS = 3  # from which a gap is compared with the usual one


def planned_row(model: DayModel, state: WatchState, posture: int, placement: int) -> int | None:
    """Return the plan's row of a posture; None: not in the plan.

    Of a posture that the plan repeats, that is one of the same placement if there is one, and of these one
    that is not measured.
    """
    rows = model.of_posture.get(posture)
    if rows is None:
        return None
    rows = [row for row in rows if model.plan.placement[row] == placement] or rows
    by_need = sorted(rows, key=lambda row: (OPEN, AGAIN, MEASURED).index(state.done[row]))
    return by_need[0] if state.done[by_need[0]] != MEASURED else rows[-1]


def begin_row(model: DayModel, state: WatchState, row: Measurements, planned: int) -> WatchState:
    """Return the state at a row before its readings are looked at: a new placement or stance may begin."""
    placement, support, time = int(row.placement[0]), str(row.support[0]), float(row.time[0])
    anew = placement != state.placement or support != state.support
    gap = time - state.time
    numbers = OF_PLACEMENT if anew else STANCE if _put_down(state, gap, planned) else 0
    if numbers:
        state = replace(
            state,
            belief=state.belief.begun(model, numbers),
            changes=state.changes.begun(numbers),
            stance=state.stance + 1,
        )
    if placement != state.placement:
        state = replace(state, information=state.information.placement_begun())
    if not anew and np.isfinite(gap) and gap > 0:
        state = replace(state, gaps=(*state.gaps, gap)[-GAPS:])
    return replace(state, placement=placement, support=support, time=time, row=planned)


def _put_down(state: WatchState, gap: float, planned: int) -> bool:
    """Return whether the robot may have been put down again within a placement, see `Observation.stance`."""
    if not np.isfinite(gap):
        return planned != state.row + 1
    usual = float(np.median(state.gaps)) if len(state.gaps) >= LEAST_GAPS else np.inf
    return gap <= 0 or gap > LONG_GAP * usual or (usual == np.inf and planned > state.row + 1)


def next_posture(model: DayModel, state: WatchState, fits: bool) -> int | None:
    """Return the number of the posture to measure next; None: all are measured.

    A posture that does not fit is measured again at once; after a change that is the first one since it. At
    the end of a placement come those of its postures that are to be measured again, then the plan goes on.

    Args:
        fits: whether the last row was taken in.
    """
    plan, done = model.plan, state.done
    if state.fault is not None:
        return state.fault.posture
    if not fits and state.row >= 0 and done[state.row] != MEASURED:
        return int(plan.posture[state.row])
    here = plan.placement == state.placement
    after = np.arange(len(plan)) > state.row
    for rows in (
        here & after & (done == OPEN),
        here & (done == AGAIN),
        after & (done == OPEN),
        done != MEASURED,
    ):
        if rows.any():
            return int(plan.posture[rows.argmax()])
    return None


def stop_reason(state: WatchState, left: int, errors: np.ndarray, targets: np.ndarray | None) -> str:
    """Return why the day may end, "" if it should not.

    Args:
        left: postures of the plan that are not measured.
        errors, targets: standard errors as they are and as they are wanted, (p,) [m].
    """
    if state.fault is not None:
        return ""
    if left == 0:
        return "every posture of the plan is measured"
    if targets is None or not np.isfinite(targets).any() or not (errors <= targets).all():
        return ""
    return f"the targets are met; {left} posture{'s are' if left > 1 else ' is'} left"
