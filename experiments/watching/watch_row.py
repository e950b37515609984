"""Check a posture as soon as its row is there, against everything that was measured before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching.alarm import (
    Level,
    clearer,
    fault_of_changes,
    fault_of_odd_rows,
    levels,
    noticed,
    still_there,
)
from tulip_testbed.experiments.watching.change_detection import newest, with_row
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.design_information import with_posture
from tulip_testbed.experiments.watching.history import remembered
from tulip_testbed.experiments.watching.next_posture import left, next_posture, stop_reason
from tulip_testbed.experiments.watching.recursive_estimate import Innovation, innovation, updated
from tulip_testbed.experiments.watching.repeats import repeat_probability, with_earlier
from tulip_testbed.experiments.watching.row_checks import USUAL, as_planned, plausible, settled, spreads_of
from tulip_testbed.experiments.watching.row_columns import RowColumns, row_columns
from tulip_testbed.experiments.watching.set_up import order_findings, planned_row, set_up, twice
from tulip_testbed.experiments.watching.watch_state import AGAIN, MEASURED, WatchState
from tulip_testbed.identification.distributions import chi2_sf
from tulip_testbed.identification.preflight.finding import Finding
from tulip_testbed.identification.residual_channels import CHANNELS, ROWS
from tulip_testbed.measurements import Measurements

OK, NOT_SETTLED, REPEAT, CHANGED = "ok", "not settled", "repeat", "changed"
UNUSABLE, UNPLANNED = "unusable", "not in the plan"
VERDICTS = (OK, NOT_SETTLED, REPEAT, CHANGED, UNUSABLE, UNPLANNED)


@dataclass(frozen=True, eq=False)
class Verdict:
    """The judgement of a watch on a posture.

    Attributes:
        posture: its number. verdict: one of `VERDICTS`.
        findings: what was found, the most serious first.
        next: number of the posture to measure next; None: all are measured.
        standard_errors: of the base parameters so far, by name [m]; infinite until they are determined.
        stop: why the day may end; "" if it should not.
        misfit: innovation of each channel, root mean square in standard deviations; NaN: not in use.
        left: postures of the plan that are still to be measured.
        onset: posture at which a change began; None: there is none.
    """

    posture: int
    verdict: str
    findings: tuple[Finding, ...]
    next: int | None
    standard_errors: Mapping[str, float]
    stop: str
    misfit: Mapping[str, float]
    left: int
    onset: int | None = None

    def document(self) -> dict[str, Any]:
        """Return the verdict for JSON."""
        return {
            "posture": self.posture,
            "verdict": self.verdict,
            "findings": [
                {
                    "check": one.name,
                    "result": one.result,
                    "seen": one.seen,
                    "expected": one.expected,
                    "where": one.where,
                    "advice": one.advice,
                }
                for one in self.findings
            ],
            "next": self.next,
            "standard_errors": dict(self.standard_errors),
            "stop": self.stop or None,
        }


def watch_row(
    model: DayModel, state: WatchState, row: Measurements, targets: np.ndarray | None = None
) -> tuple[WatchState, Verdict]:
    """Take in one row and say what it shows.

    Args:
        row: measurements of one row, which hold the contract.
        targets: standard errors that are wanted, (p,) [m]; infinite: none is; None: none at all.

    Returns:
        the state after the row, and the verdict; the state that was given is not changed.
    """
    level = levels(model)
    state = replace(state, seen=state.seen + 1)
    posture = int(row.posture[0])
    planned = planned_row(model, state, posture, int(row.placement[0]))
    if planned is None:
        found = Finding(
            "posture", "fail", f"posture {posture}", "a posture of the plan", "", "Look at its number."
        )
        return state, _verdict(model, state, targets, UNPLANNED, [found], posture)
    if float(row.time[0]) == state.time and planned == state.row:
        return state, _verdict(model, state, targets, UNUSABLE, [twice(posture)], posture)
    findings = order_findings(model, state, row, planned)
    bad, verdict = _unusable(model, state, row, planned, level)
    findings += bad
    state = set_up(model, state, row, planned)
    if verdict:
        state = replace(state, done=_marked(state.done, planned, AGAIN))
        return state, _verdict(model, state, targets, verdict, findings, posture)
    state = replace(state, spreads=_remembered(state.spreads, row))
    columns = row_columns(model, row).row(0)
    return _judged(model, state, targets, columns, planned, level, findings)


def _judged(
    model: DayModel,
    state: WatchState,
    targets: np.ndarray | None,
    columns: RowColumns,
    planned: int,
    level: Level,
    findings: list[Finding],
) -> tuple[WatchState, Verdict]:
    """Hold a plausible row against the model of the day."""
    found, posture = innovation(model, state.belief, columns), int(model.plan.posture[planned])
    misfit = _misfit(found)
    if state.fault is not None:
        state, cleared = still_there(model, state, found)
        if state.fault is not None:
            findings = [clearer(model, state.fault), *findings]
            state = replace(state, done=_marked(state.done, planned, AGAIN))
            return state, _verdict(model, state, targets, CHANGED, findings, posture, misfit)
        findings = [cleared, *findings]
    again = repeat_probability(model, state, columns, planned)
    alone = float(chi2_sf(found.chi_square, found.freedom))
    changes = with_row(state.changes, found, state.count, model.ramps)
    sudden = float(changes.ratio[newest(changes)].max())
    if alone < level.row or again < level.repeat or sudden > level.ratio:
        findings = [_odd(found, alone, again), *findings]
        state = replace(state, done=_marked(state.done, planned, AGAIN))
        state = fault_of_odd_rows(model, state, found, planned)
        if state.fault is not None:
            findings = [noticed(model, state.fault), *findings]
        verdict = REPEAT if state.fault is None else CHANGED
        return state, _verdict(model, state, targets, verdict, findings, posture, misfit)
    state = remembered(state, planned)
    state = replace(
        state,
        odd=0,
        changes=changes,
        belief=updated(state.belief, found),
        information=with_posture(state.information, model, columns),
        earlier=with_earlier(model, state, columns, planned),
        done=_marked(state.done, planned, MEASURED),
        count=state.count + 1,
    )
    state = fault_of_changes(model, state, level)
    if state.fault is not None:
        findings = [noticed(model, state.fault), *findings]
        return state, _verdict(model, state, targets, CHANGED, findings, posture, misfit)
    return state, _verdict(model, state, targets, OK, findings, posture, misfit)


def _unusable(
    model: DayModel, state: WatchState, row: Measurements, planned: int, level: Level
) -> tuple[list[Finding], str]:
    """Return what the row alone shows, and the verdict if it cannot be used, otherwise ""."""
    findings = plausible(row, model.nominal, level.row)
    if any(one.result == "fail" for one in findings):
        return findings, UNUSABLE
    off = as_planned(row, model.plan.joint_angles[planned], model.plan.joints)
    if off is not None:
        return [off, *findings], UNUSABLE
    rest = settled(row, state.spreads)
    if rest is not None:
        return [rest, *findings], NOT_SETTLED if rest.result == "fail" else ""
    return findings, ""


def _remembered(spreads: np.ndarray, row: Measurements) -> np.ndarray:
    one = spreads_of(row)[None]
    return one if not len(spreads) else np.concatenate([spreads, one])[-USUAL:]


def _marked(done: np.ndarray, row: int, mark: int) -> np.ndarray:
    out = done.copy()
    out[row] = mark
    return out


def _misfit(found: Innovation) -> dict[str, float]:
    """Return the innovation of each channel in its own standard deviations, root mean square."""
    share = found.value / np.sqrt(np.diag(found.covariance))
    return {name: float(np.sqrt((share[ROWS[name]] ** 2).mean())) for name in CHANNELS}


def _odd(found: Innovation, alone: float, again: float) -> Finding:
    """Tell of a posture that does not fit."""
    worst = max(_misfit(found).items(), key=lambda each: each[1])
    if again < alone:
        return Finding(
            "repeats",
            "fail",
            f"differs from its repeat (p = {number(again, '.1g')})",
            "repeats that agree within the stated noise",
            f"channel {worst[0]}",
            "Measure it again; if it differs again, look for what moved.",
            again,
        )
    return Finding(
        "prediction",
        "fail",
        f"{number(worst[1], '.1f')} s.d. from the prediction in channel {worst[0]} "
        f"(p = {number(alone, '.1g')})",
        "readings as the postures before predict them",
        f"channel {worst[0]}",
        "Measure it again; if it does not fit again, something has changed.",
        alone,
    )


def _verdict(
    model: DayModel,
    state: WatchState,
    targets: np.ndarray | None,
    verdict: str,
    findings: list[Finding],
    posture: int,
    misfit: Mapping[str, float] | None = None,
) -> Verdict:
    errors = state.information.standard_errors()
    order = ("fail", "warn", "pass")
    return Verdict(
        posture=posture,
        verdict=verdict,
        findings=tuple(sorted(findings, key=lambda one: order.index(one.result))),
        next=next_posture(model, state, verdict == OK),
        standard_errors=dict(zip(model.nominal.parameters.names, errors.tolist(), strict=True)),
        stop=stop_reason(model, state, errors, targets),
        misfit=misfit or dict.fromkeys(CHANNELS, float("nan")),
        left=left(state),
        onset=None if state.fault is None else state.fault.posture,
    )
