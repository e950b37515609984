"""States before the rows at which a change may have begun, so that a watch can return there."""

from __future__ import annotations

from dataclasses import replace

from tulip_testbed.experiments.watching.change_detection import APART, EARLIER, RECENT
from tulip_testbed.experiments.watching.watch_state import Before, WatchState

REACH = RECENT + APART * EARLIER + APART  # rows back to the earliest onset


def remembered(state: WatchState, planned: int) -> WatchState:
    """Return the state that also remembers what is known before the row that comes now.

    Args:
        planned: the plan's row.
    """
    now = Before(state.count, state.placement, state.stance, state.belief, state.information)
    kept = tuple(one for one in state.history if _is_onset(one.count, state.count))
    return replace(state, history=(*kept, now), taken=(*state.taken, planned)[-REACH:])


def _is_onset(onset: int, count: int) -> bool:
    """Return whether an onset is still looked at when row `count` comes, see `change_detection`."""
    back = count - onset
    return back < RECENT or (onset % APART == 0 and back < RECENT + APART * EARLIER + APART)
