"""When a watch raises an alarm, and how it notices that the cause is gone.

The error rates are of a whole day: the sum of `FALSE_ALARMS` is the probability of any false alarm in a day
in which nothing begins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching.change_detection import no_changes
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.design_information import placement_begun
from tulip_testbed.experiments.watching.recursive_estimate import ANEW, Innovation, begun
from tulip_testbed.experiments.watching.repeats import first_of
from tulip_testbed.experiments.watching.watch_state import AGAIN, Fault, WatchState
from tulip_testbed.identification.distributions import chi2_isf
from tulip_testbed.identification.preflight.finding import Finding

FALSE_ALARMS = {"row": 0.001, "repeat": 0.001, "change": 0.003}  # a day
# Independent tests a posture to which the ratios of all kinds and onsets amount, by the distribution of their
# largest value over clean days of development seeds (docs/how-to/watch.md).
TESTS = 175.0
ODD_ROWS = 2  # in succession, that are a change
GONE = 10.0  # ln of the likelihood ratio, from which a change counts as gone


@dataclass(frozen=True)
class Level:
    """Limits of a day.

    Attributes:
        row: p-value below which a row does not fit. repeat: that of its difference from the last time.
        ratio: of a change, twice the ln of the likelihood ratio.
    """

    row: float
    repeat: float
    ratio: float


def levels(model: DayModel) -> Level:
    """Return the limits that keep `FALSE_ALARMS` over a plan."""
    row, repeat, change = (FALSE_ALARMS[name] / len(model.plan) for name in ("row", "repeat", "change"))
    return Level(row, repeat, float(chi2_isf(change / TESTS, 1)))


def fault_of_changes(model: DayModel, state: WatchState, level: Level) -> WatchState:
    """Return the state with the change that the evidence shows, if it shows one.

    The estimate returns to what it was before the change began; the postures since are to be measured again,
    and what they showed is forgotten: no repeat is compared with it.
    """
    ratio = state.changes.ratio
    slot, direction = np.unravel_index(ratio.argmax(), ratio.shape)
    if ratio[slot, direction] <= level.ratio:
        return state
    onset = int(state.changes.onset[slot])
    before = next(one for one in state.history if one.count == onset)
    rows = state.taken[onset - state.count :]
    size = float(state.changes.pull[slot, direction] / state.changes.information[slot, direction])
    fault = Fault(int(direction), onset, int(model.plan.posture[rows[0]]), size)
    done = state.done.copy()
    done[list(rows)] = AGAIN
    moved, anew = before.placement != state.placement, before.stance != state.stance
    there = state.earlier.there.copy()
    there[[first_of(model, row) for row in rows]] = False
    return replace(
        state,
        belief=begun(model, before.belief, ANEW) if anew else before.belief,
        information=placement_begun(before.information) if moved else before.information,
        earlier=replace(state.earlier, there=there),
        done=done,
        fault=fault,
        odd=0,
    )


def fault_of_odd_rows(model: DayModel, state: WatchState, found: Innovation, planned: int) -> WatchState:
    """Return the state with one more row that does not fit; several in succession are a change."""
    weighed = found.precision @ found.faults
    pull, information = found.value @ weighed, (found.faults * weighed).sum(axis=0)
    first = state.odd == 0
    state = replace(
        state,
        odd=state.odd + 1,
        odd_posture=int(model.plan.posture[planned]) if first else state.odd_posture,
        odd_pull=pull if first else state.odd_pull + pull,
        odd_information=information if first else state.odd_information + information,
    )
    if state.odd < ODD_ROWS:
        return state
    steps = ~model.ramps & (state.odd_information > 0)
    ratio = np.where(steps, state.odd_pull**2 / np.where(steps, state.odd_information, 1.0), 0.0)
    direction = int(ratio.argmax())
    size = float(state.odd_pull[direction] / state.odd_information[direction])
    return replace(state, fault=Fault(direction, state.count, state.odd_posture, size), odd=0)


def still_there(model: DayModel, state: WatchState, found: Innovation) -> tuple[WatchState, Finding]:
    """Return the state with or without the change after one more row, and what to say if it has gone.

    While a change is there, no row is taken in.
    """
    fault = state.fault
    assert fault is not None
    signature = fault.size * found.faults[:, fault.direction]
    there = float(signature @ found.precision @ (found.value - signature / 2))
    gone = max(0.0, fault.gone - there)
    seen = f"the change since posture {fault.posture} is gone"
    told = Finding("change", "warn", seen, "", "", "Measure the postures since then again.")
    if gone <= GONE:
        return replace(state, fault=replace(fault, gone=gone)), told
    empty = no_changes(len(state.belief.mean), len(model.directions))
    return replace(state, fault=None, changes=empty, history=(), odd=0), told


def noticed(model: DayModel, fault: Fault) -> Finding:
    """Tell of a change that was noticed now."""
    one = model.directions[fault.direction]
    return Finding(
        "change",
        "fail",
        f"since posture {fault.posture} something is different; best explanation: {one.told(fault.size)}",
        "a laboratory that stays as it is",
        f"from posture {fault.posture} on",
        f"Look there first, correct it, and measure again from posture {fault.posture} on.",
    )


def clearer(model: DayModel, fault: Fault) -> Finding:
    """Tell of a change that is still there."""
    one = model.directions[fault.direction]
    return Finding(
        "change",
        "fail",
        f"the change since posture {fault.posture} is still there ({one.told(fault.size)}); "
        f"evidence that it has gone: {number(fault.gone, '.1f')} of {GONE:g}",
        "a laboratory that stays as it is",
        f"from posture {fault.posture} on",
        f"Correct it and measure again from posture {fault.posture} on; until then nothing counts.",
    )
