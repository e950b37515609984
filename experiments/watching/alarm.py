"""When a watch raises an alarm, and how it notices that the cause is gone.

The error rates are of a whole day: the sum of `FALSE_ALARMS` is the probability of any false alarm in a day
in which nothing begins.
"""

from dataclasses import replace

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.row_columns import RowColumns
from tulip_testbed.experiments.watching.watch_state import (
    AGAIN,
    OF_PLACEMENT,
    Changes,
    Fault,
    Innovation,
    WatchState,
)
from tulip_testbed.identification.distributions import chi2_isf, chi2_sf
from tulip_testbed.identification.preflight.finding import Finding

FALSE_ALARMS = {"row": 0.001, "repeat": 0.001, "change": 0.003}  # a day
# Independent tests a posture to which the ratios of all kinds and onsets amount, by the distribution of their
# largest value over clean days of development seeds (docs/how-to/watch.md).
TESTS = 175.0
ODD_ROWS = 2  # in succession, that are a change
GONE = 10.0  # ln of the likelihood ratio, from which a change counts as gone


def level(model: DayModel, kind: str) -> float:
    """Return the p-value of a row, a repeat or a change that keeps `FALSE_ALARMS` over a plan."""
    return FALSE_ALARMS[kind] / model.rows


def largest_ratio(model: DayModel) -> float:
    """Return the limit of twice the logarithm of a change's likelihood ratio."""
    return float(chi2_isf(level(model, "change") / TESTS, 1))


def repeat_probability(model: DayModel, state: WatchState, here: RowColumns, posture: int) -> float:
    """Return the p-value of a posture's difference from its last time; 1 if there was none.

    No model of the robot enters but its change.

    Args:
        here: the row's columns about the present estimate.
    """
    if posture not in state.earlier:
        return 1.0
    stance, then = state.earlier[posture]
    shared, prior = slice(0, len(state.belief.mean) - OF_PLACEMENT), model.covariance[-OF_PLACEMENT:]
    change = here.state - then.state
    left = here.residual - then.residual - change[:, shared] @ state.belief.mean[shared]
    spread = here.noise(model.noise.encoder) + then.noise(model.noise.encoder)
    spread = spread + change[:, shared] @ state.belief.covariance[shared, shared] @ change[:, shared].T
    for slope in (change,) if stance == state.stance else (here.state, then.state):
        spread = spread + slope[:, -OF_PLACEMENT:] @ prior[:, -OF_PLACEMENT:] @ slope[:, -OF_PLACEMENT:].T
    used = here.used & then.used
    left, spread = left[used], spread[np.ix_(used, used)]
    scale = 1 / np.sqrt(np.diag(spread))
    square = float(scale * left @ np.linalg.solve(scale[:, None] * spread * scale, scale * left))
    return float(chi2_sf(square, used.sum()))


def fault_of_changes(model: DayModel, state: WatchState) -> WatchState:
    """Return the state with the change that the evidence shows, if it shows one.

    The estimate returns to what it was before the change began; the postures since are to be measured again,
    and what they showed is forgotten: no repeat is compared with it.
    """
    ratio = state.changes.ratio
    slot, direction = np.unravel_index(ratio.argmax(), ratio.shape)
    if ratio[slot, direction] <= largest_ratio(model):
        return state
    onset = int(state.changes.onset[slot])
    before = next(known for known in state.history if known.count == onset)
    rows = list(state.taken[onset - state.count :])
    size = float(state.changes.pull[slot, direction] / state.changes.information[slot, direction])
    moved, belief = before.placement != state.placement, before.belief
    if before.stance != state.stance:
        belief = belief.later(model, slice(-OF_PLACEMENT, None), 0.0)
    return replace(
        state.marked(rows, AGAIN),
        belief=belief.later(model, model.lasting, 0.0),
        information=before.information.placement_begun() if moved else before.information,
        earlier=before.earlier,
        fault=Fault(int(direction), onset, model.number(rows[0]), size),
        odd=(),
    )


def fault_of_odd_rows(model: DayModel, state: WatchState, innovation: Innovation, posture: int) -> WatchState:
    """Return the state with one more row that does not fit; several in succession are a change."""
    odd = (*state.odd, (posture, innovation))
    if len(odd) < ODD_ROWS:
        return replace(state, odd=odd)
    weighed = [(each.value, each.faults, each.precision @ each.faults) for _, each in odd]
    pull = np.sum([value @ across for value, _, across in weighed], axis=0)
    information = np.sum([(faults * across).sum(axis=0) for _, faults, across in weighed], axis=0)
    steps = ~model.ramps & (information > 0)
    ratio = np.where(steps, pull**2 / np.where(steps, information, 1.0), 0.0)
    direction = int(ratio.argmax())
    size = float(pull[direction] / information[direction])
    return replace(state, fault=Fault(direction, state.count, odd[0][0], size), odd=())


def still_there(model: DayModel, state: WatchState, innovation: Innovation) -> tuple[WatchState, Finding]:
    """Return the state after one more row, not taken in while the change is there, and what to say of it."""
    fault = state.fault
    assert fault is not None
    signature = fault.size * innovation.faults[:, fault.direction]
    there = float(signature @ innovation.precision @ (innovation.value - signature / 2))
    there *= model.independent  # the estimate stands still, so that noise that lasts is in every row
    gone = max(0.0, fault.gone - there)
    if gone <= GONE:
        fault = replace(fault, gone=gone)
        seen = (
            f"the change since {model.unit} {fault.posture} is still there "
            f"({model.directions[fault.direction].words(fault.size)}); "
            f"evidence that it has gone: {number(fault.gone, '.1f')} of {GONE:g}"
        )
        again = (
            f"Correct it and measure again from {model.unit} {fault.posture} on; until then nothing counts."
        )
        return replace(state, fault=fault), _change(model, fault, seen, again)
    seen = f"the change since {model.unit} {fault.posture} is gone"
    cleared = Finding("change", "warn", seen, "", "", f"Measure the {model.unit}s since then again.")
    empty = Changes.none(len(state.belief.mean), len(model.directions))
    return replace(state, fault=None, changes=empty, history=(), odd=()), cleared


def noticed(model: DayModel, fault: Fault) -> Finding:
    return _change(
        model,
        fault,
        f"since {model.unit} {fault.posture} something is different; best explanation: "
        f"{model.directions[fault.direction].words(fault.size)}",
        f"Look there first, correct it, and measure again from {model.unit} {fault.posture} on.",
    )


def _change(model: DayModel, fault: Fault, seen: str, advice: str) -> Finding:
    where = f"from {model.unit} {fault.posture} on"
    return Finding("change", "fail", seen, "a laboratory that stays as it is", where, advice)
