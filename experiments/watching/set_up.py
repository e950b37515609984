"""When a placement or a stance begins, and what is wrong with the order of rows or with their clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching.change_detection import changes_begun
from tulip_testbed.experiments.watching.day_model import STANCE, DayModel
from tulip_testbed.experiments.watching.design_information import placement_begun
from tulip_testbed.experiments.watching.recursive_estimate import ANEW, begun
from tulip_testbed.experiments.watching.watch_state import AGAIN, GAPS, MEASURED, OPEN, WatchState
from tulip_testbed.identification.observation import LONG_GAP
from tulip_testbed.identification.preflight.finding import Finding
from tulip_testbed.measurements import Measurements

LEAST_GAPS = 3  # from which a gap is compared with the usual one
BREAK = 3600.0  # s: a longer time between two rows is a break, or a clock that jumped


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


def twice(posture: int) -> Finding:
    """Tell of a row that came twice: its noise is the same, so that it would count for more than it says."""
    return Finding(
        "order",
        "fail",
        f"posture {posture} at the same time as in the row before",
        "a row for every measurement",
        f"posture {posture}",
        "Delete one of the two rows.",
    )


def order_findings(model: DayModel, state: WatchState, row: Measurements, planned: int) -> list[Finding]:
    """Return what is odd about placement, order and time of a row."""
    found, where = [], f"posture {row.posture[0]}"
    if (placement := int(row.placement[0])) != (expected := int(model.plan.placement[planned])):
        found.append(
            Finding(
                "placement",
                "warn",
                f"placement {placement}",
                f"placement {expected}, as in the plan",
                where,
                "Correct the number if the plates were not laid again.",
            )
        )
    later = float(row.time[0]) - state.time
    if not np.isfinite(later) or -BREAK <= later < 0 <= state.row - planned or 0 <= later <= BREAK:
        if np.isfinite(later) and later < 0:
            seen = f"{number(-later, '.0f')} s before the row before it"
            found.append(
                Finding(
                    "order", "warn", seen, "rows in the order of time", where, "The row is used as it is."
                )
            )
        return found
    way = "back" if later < 0 else "ahead"
    found.append(
        Finding(
            "clock",
            "warn",
            f"the time jumps {way} by {number(abs(later), '.0f')} s",
            f"times that increase, by less than {BREAK:.0f} s",
            where,
            "After a break look for what changed, else correct the clock. The foot counts as put down again.",
        )
    )
    return found


def set_up(model: DayModel, state: WatchState, row: Measurements, planned: int) -> WatchState:
    """Return the state at a row before its readings are looked at: a new placement or stance may begin."""
    placement, support, time = int(row.placement[0]), str(row.support[0]), float(row.time[0])
    anew = placement != state.placement or support != state.support
    gap = time - state.time
    numbers = ANEW if anew else STANCE if _put_down(state, gap, planned) else 0
    if numbers:
        state = replace(
            state,
            belief=begun(model, state.belief, numbers),
            changes=changes_begun(state.changes, numbers),
            stance=state.stance + 1,
        )
    if placement != state.placement:
        state = replace(state, information=placement_begun(state.information))
    if not anew and np.isfinite(gap) and gap > 0:
        state = replace(state, gaps=(*state.gaps, gap)[-GAPS:])
    return replace(state, placement=placement, support=support, time=time, row=planned)


def _put_down(state: WatchState, gap: float, planned: int) -> bool:
    """Return whether the robot may have been put down again within a placement, see `Observation.stance`."""
    if not np.isfinite(gap):
        return planned != state.row + 1
    usual = float(np.median(state.gaps)) if len(state.gaps) >= LEAST_GAPS else np.inf
    return gap <= 0 or gap > LONG_GAP * usual or (usual == np.inf and planned > state.row + 1)
