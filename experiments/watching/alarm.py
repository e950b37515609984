"""Compare a row with the model of the day: what raises an alarm, and when its cause is gone.

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
    REACH,
    Changes,
    DesignInformation,
    Fault,
    Innovation,
    WatchState,
)
from tulip_testbed.identification.distributions import chi2_isf, chi2_sf
from tulip_testbed.identification.preflight.finding import Finding
from tulip_testbed.identification.residual_channels import CHANNELS, ROWS

OK, REPEAT, CHANGED = "ok", "repeat", "changed"
ODD = "does not fit"  # of a row of a motion, which nobody can repeat
FALSE_ALARMS = {"row": 0.001, "repeat": 0.001, "change": 0.003}  # a day
# Independent tests a posture to which the ratios of all kinds and onsets amount, by the distribution of their
# largest value over clean days of development seeds (docs/how-to/watch.md).
TESTS = 175.0
GONE = 10.0  # ln of the likelihood ratio, from which a change counts as gone


def level(model: DayModel, kind: str) -> float:
    """Return the p-value of a row, a repeat or a change that keeps `FALSE_ALARMS` over a plan."""
    return FALSE_ALARMS[kind] / model.rows


def largest_ratio(model: DayModel) -> float:
    """Return the limit of twice the logarithm of a change's likelihood ratio."""
    return float(chi2_isf(level(model, "change") / TESTS, 1))


def judge(
    model: DayModel, state: WatchState, columns: RowColumns, posture: int, kept: float
) -> tuple[WatchState, str, list[Finding]]:
    """Compare a plausible row with the model of the day and take it in if it fits.

    Args:
        state: in which the row has begun. posture: its number.
        kept: correlation of its noise with that of the row before.

    Returns:
        the state after the row, the verdict and what to say of it.
    """
    innovation, findings = state.belief.predict(model, columns), []
    if state.fault is not None:
        state, change = _still_there(model, state, state.fault, innovation)
        findings = [change]
        if state.fault is not None:
            return state, CHANGED, findings
    here = innovation.here
    again = _repeat_probability(model, state, here, posture)
    alone = float(chi2_sf(innovation.chi_square, int(here.used.sum())))
    changes = state.changes.with_row(innovation, state.count, model.ramps)
    sudden = float(changes.ratio[changes.onset.argmax()].max())  # of one row alone
    unlikely = alone < level(model, "row") or again < level(model, "repeat")
    if unlikely or sudden > largest_ratio(model):
        findings = [_misfit(innovation, alone, again), *findings]
        state = _fault_of_odd_rows(model, state, innovation, posture)
        verdict = REPEAT if model.held else ODD
    else:
        before = replace(state, history=(), changes=Changes.none(0, 0))
        state = replace(
            state,
            belief=state.belief.updated(innovation),
            changes=changes,
            information=state.information.with_posture(model, columns, kept),
            earlier=state.earlier | ({posture: (state.stance, here)} if model.held else {}),
            odd=None,
            history=tuple(one for one in (*state.history, before) if one.count in changes.onset),
            taken=(*state.taken, state.row)[-REACH:],
            count=state.count + 1,
        )
        state = fault_of_changes(model, state)
        verdict = OK
    if (fault := state.fault) is not None:
        verdict, unit = CHANGED, model.unit
        seen = (
            f"since {unit} {fault.posture} something is different; best explanation: {_words(model, fault)}"
        )
        advice = f"Look there first, correct it, and measure again from {unit} {fault.posture} on."
        findings = [_change(model, fault, seen, advice), *findings]
    return state, verdict, findings


def _repeat_probability(model: DayModel, state: WatchState, here: RowColumns, posture: int) -> float:
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
    changes, ratio = state.changes, state.changes.ratio
    slot, direction = np.unravel_index(ratio.argmax(), ratio.shape)
    if ratio[slot, direction] <= largest_ratio(model):
        return state
    before = next(known for known in state.history if known.count == changes.onset[slot])
    belief, information = before.belief, before.information
    if before.stance != state.stance:
        belief = belief.later(model, slice(-OF_PLACEMENT, None), 0.0)
    if before.placement != state.placement:
        information = DesignInformation.begun(information.whole)
    size = float(changes.pull[slot, direction] / changes.information[slot, direction])
    first = int(model.plan.posture[before.row]) if model.held else before.row
    return replace(
        state.marked(list(state.taken[before.count - state.count :]), AGAIN),
        belief=belief.later(model, model.lasting, 0.0),
        information=information,
        earlier=before.earlier,
        fault=Fault(int(direction), first, size),
        odd=None,
    )


def _fault_of_odd_rows(
    model: DayModel, state: WatchState, innovation: Innovation, posture: int
) -> WatchState:
    """Return the state with one more row that does not fit; two in succession are a change."""
    if state.odd is None:
        return replace(state, odd=(posture, innovation))
    first, before = state.odd
    pull, information = before.evidence + innovation.evidence
    steps = ~model.ramps & (information > 0)
    ratio = np.where(steps, pull**2 / np.where(steps, information, 1.0), 0.0)
    direction = int(ratio.argmax())
    fault = Fault(direction, first, float(pull[direction] / information[direction]))
    return replace(state, fault=fault, odd=None)


def _still_there(
    model: DayModel, state: WatchState, fault: Fault, innovation: Innovation
) -> tuple[WatchState, Finding]:
    """Return the state after one more row, not taken in while the change is there, and what to say of it."""
    signature = fault.size * innovation.here.faults[:, fault.direction]
    there = float(signature @ innovation.precision @ (innovation.value - signature / 2))
    there *= model.independent  # the estimate stands still, so that noise that lasts is in every row
    fault = replace(fault, gone=max(0.0, fault.gone - there))
    since = f"{model.unit} {fault.posture}"
    if fault.gone <= GONE:
        evidence = f"evidence that it has gone: {number(fault.gone, '.1f')} of {GONE:g}"
        seen = f"the change since {since} is still there ({_words(model, fault)}); {evidence}"
        again = f"Correct it and measure again from {since} on; until then nothing counts."
        return replace(state, fault=fault), _change(model, fault, seen, again)
    seen, advice = f"the change since {since} is gone", f"Measure the {model.unit}s since then again."
    empty = Changes.none(len(state.belief.mean), len(model.directions))
    state = replace(state, fault=None, changes=empty, history=(), odd=None)
    return state, Finding("change", "warn", seen, advice=advice)


def _words(model: DayModel, fault: Fault) -> str:
    """Tell a change, of a ramp that in ten postures, in words."""
    one, ramp = model.directions[fault.direction], model.ramps[fault.direction]
    parameters = one.effect.parameters_on(one.target)
    values = [parameters[k].text(fault.size * one.values[k]) for k in one.effect.sizes if one.values[k]]
    sort = "drifts by about {} in ten postures" if ramp else "changed by about {}"
    return f"{one.label}: {sort.format(', '.join(values))}"


def _change(model: DayModel, fault: Fault, seen: str, advice: str) -> Finding:
    where = f"from {model.unit} {fault.posture} on"
    return Finding("change", "fail", seen, "a laboratory that stays as it is", where, advice)


def _misfit(innovation: Innovation, alone: float, again: float) -> Finding:
    """Tell of a row that does not fit, by the channel with the largest r.m.s. innovation.

    Args:
        alone, again: p-values of the innovation and of the difference from its repeat.
    """
    share = innovation.value / np.sqrt(np.diag(innovation.covariance))
    misfit = {name: float(np.sqrt((share[ROWS[name]] ** 2).mean())) for name in CHANNELS}
    channel, size = max(misfit.items(), key=lambda each: each[1])
    where = f"channel {channel}"
    if again < alone:
        seen = f"differs from its repeat (p = {number(again, '.1g')})"
        expected = "repeats that agree within the stated noise"
        advice = "Measure it again; if it differs again, look for what moved."
        return Finding("repeats", "fail", seen, expected, where, advice, again)
    seen = f"{number(size, '.1f')} s.d. from the prediction in {where} (p = {number(alone, '.1g')})"
    advice = "Measure it again; if it does not fit again, something has changed."
    return Finding(
        "prediction", "fail", seen, "readings as the postures before predict them", where, advice, alone
    )
