"""Which posture comes next, and when the day may end."""

from __future__ import annotations

import numpy as np

from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.watch_state import AGAIN, MEASURED, OPEN, WatchState


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


def left(state: WatchState) -> int:
    """Count the postures of the plan that are not measured yet, or not well."""
    return int((state.done != MEASURED).sum())


def stop_reason(model: DayModel, state: WatchState, errors: np.ndarray, targets: np.ndarray | None) -> str:
    """Return why the day may end, "" if it should not.

    Args:
        errors, targets: standard errors as they are and as they are wanted, (p,) [m].
    """
    rest = left(state)
    if state.fault is not None:
        return ""
    if rest == 0:
        return "every posture of the plan is measured"
    if targets is None or not np.isfinite(targets).any() or not (errors <= targets).all():
        return ""
    return f"the targets are met; {rest} posture{'s are' if rest > 1 else ' is'} left"
