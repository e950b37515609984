"""Check a posture as soon as its row is there, against everything that was measured before it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching import alarm
from tulip_testbed.experiments.watching.day_model import STANCE, DayModel
from tulip_testbed.experiments.watching.row_checks import (
    UNUSABLE,
    USUAL,
    order_findings,
    refused,
    rocking,
    spreads_of,
    unfit,
)
from tulip_testbed.experiments.watching.row_columns import RowColumns, row_columns
from tulip_testbed.experiments.watching.watch_state import (
    AGAIN,
    GAPS,
    MEASURED,
    OF_PLACEMENT,
    OPEN,
    Innovation,
    WatchState,
)
from tulip_testbed.identification.distributions import chi2_sf
from tulip_testbed.identification.observation import LONG_GAP, STILL
from tulip_testbed.identification.preflight.finding import Finding
from tulip_testbed.identification.residual_channels import CHANNELS, ROWS
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS

LEAST_GAPS = 3  # from which a gap is compared with the usual one
OK, REPEAT, CHANGED, UNPLANNED = "ok", "repeat", "changed", "not in the plan"
ODD = "does not fit"  # of a row of a motion, which nobody can repeat
TOLD = ("result", "seen", "expected", "where", "advice")  # of a finding in JSON
SERIOUS_FIRST = ("fail", "warn", "pass")


def planned_row(model: DayModel, state: WatchState, posture: int, placement: int) -> int | None:
    """Return the plan's row of a posture; None: not in the plan.

    A row of a motion is its own number, if the plan has its placement. Of a posture that the plan repeats,
    that is one of the same placement if there is one, and of these one that is not measured.
    """
    if model.window is not None:
        return posture if placement in model.plan.placement else None
    rows = np.flatnonzero(model.plan.posture == posture).tolist()
    if not rows:
        return None
    rows = [row for row in rows if model.plan.placement[row] == placement] or rows
    by_need = sorted(rows, key=lambda row: (OPEN, AGAIN, MEASURED).index(state.done[row]))
    return by_need[0] if state.done[by_need[0]] != MEASURED else rows[-1]


def begin_row(model: DayModel, state: WatchState, row: Measurements, planned: int) -> WatchState:
    """Return the state at a row before its readings are looked at: a new placement or stance may begin."""
    placement, support, time = int(row.placement[0]), str(row.support[0]), float(row.time[0])
    anew = placement != state.placement or support != state.support
    gap = time - state.time
    usual = float(np.median(state.gaps)) if len(state.gaps) >= LEAST_GAPS else np.inf
    # Within a placement the robot may have been put down again, see `Observation.stance`.
    put_down = planned != state.row + 1
    stood = state.stood
    if model.window is not None:  # feet creep below moving legs, see `Observation.stance`
        put_down = not 0 < gap <= LONG_GAP * model.window or time - stood >= STILL
        state = _later(model, state, model.lasting, model.kept(gap))
    elif np.isfinite(gap):
        put_down = gap <= 0 or gap > LONG_GAP * usual or (usual == np.inf and planned > state.row + 1)
    numbers = OF_PLACEMENT if anew else STANCE if put_down else 0
    if numbers:
        state = _later(model, state, slice(-numbers, None), 0.0)
        state = replace(state, stance=state.stance + 1, stood=time)
    if placement != state.placement:
        state = replace(state, information=state.information.placement_begun())
    if not anew and np.isfinite(gap) and gap > 0:
        state = replace(state, gaps=(*state.gaps, gap)[-GAPS:])
    return replace(state, placement=placement, support=support, time=time, row=planned)


def _later(model: DayModel, state: WatchState, at: slice, kept: float) -> WatchState:
    return replace(state, belief=state.belief.later(model, at, kept), changes=state.changes.later(at, kept))


def next_posture(model: DayModel, state: WatchState, fits: bool) -> int | None:
    """Return the number of the posture to measure next; None: all are measured.

    A posture that does not fit is measured again at once; after a change that is the first one since it. At
    the end of a placement come those of its postures that are to be measured again, then the plan goes on.

    Args:
        fits: whether the last row was taken in.
    """
    if model.window is not None:
        return None
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


@dataclass(frozen=True, eq=False)
class Verdict:
    """The judgement of a watch on a posture.

    Attributes:
        posture: its number, or that of a row of a motion.
        verdict: "ok", "not settled", "repeat", "changed", "unusable" or "not in the plan"; in a motion
            "does not fit" in place of "repeat".
        findings: what was found, the most serious first.
        next: number of the posture to measure next; None: all are measured.
        standard_errors: of the base parameters so far, by name [m]; infinite until they are determined.
        stop: why the day may end; "" if it should not.
        left: postures of the plan that are still to be measured.
        onset: posture at which a change began; None: there is none.
        time: at which a row of a motion begins [s]; None: the robot held a posture, which `next` and `left`
            are for.
    """

    posture: int
    verdict: str
    findings: tuple[Finding, ...]
    next: int | None
    standard_errors: Mapping[str, float]
    stop: str
    left: int
    onset: int | None = None
    time: float | None = None

    def to_json(self) -> dict[str, Any]:
        moving = self.time is not None
        return {
            **({"row": self.posture, "time": self.time} if moving else {"posture": self.posture}),
            "verdict": self.verdict,
            "findings": [
                {"check": finding.name} | {name: getattr(finding, name) for name in TOLD}
                for finding in self.findings
            ],
            **({} if moving else {"next": self.next}),
            "standard_errors": dict(self.standard_errors),
            "stop": self.stop or None,
        }

    def __str__(self) -> str:
        found = "; ".join(f"{finding.name}: {finding.seen}" for finding in self.findings)
        seen = f" - {found}" if found else ""
        then = "" if self.next is None else f"; next {self.next}, {self.left} left"
        stop = f"; stop: {self.stop}" if self.stop else ""
        at = f"posture {self.posture}" if self.time is None else f"row {self.posture}, {self.time:.1f} s"
        return f"{at}: {self.verdict}{seen}{then}{stop}"


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
    posture = int(row.posture[0])
    planned = planned_row(model, state, posture, int(row.placement[0]))
    wrong = refused(model, state, row, planned)
    verdict, findings = UNPLANNED if planned is None else UNUSABLE, [] if wrong is None else [wrong]
    if planned is not None and wrong is None:
        verdict, odd = unfit(model, state, row, planned, alarm.level(model, "row"))
        findings = [*order_findings(model, state, row, planned), *odd]
        kept = model.shares[0] * model.kept(float(row.time[0]) - state.time)
        state = begin_row(model, state, row, planned)
        if verdict:
            state = state.marked(planned, AGAIN)
        else:
            spreads = spreads_of(row)[None]
            columns = row_columns(model, row).row(0)
            if model.window is not None:
                rocks = rocking(row, state.spreads)
                columns = _without_noise(model, state, row, columns.without_twist(rocks)).without_twist(rocks)
            spreads = np.concatenate([state.spreads, spreads])[-USUAL:] if len(state.spreads) else spreads
            state, verdict, told = _judge(model, replace(state, spreads=spreads), columns, planned, kept)
            findings = [*told, *findings]
    errors = state.information.standard_errors()
    left, stop = int((state.done != MEASURED).sum()), ""
    met = targets is not None and np.isfinite(targets).any() and bool((errors <= targets).all())
    if state.fault is None and met and model.window is not None:
        stop = "the targets are met"
    elif state.fault is None and (met or (left == 0 and model.window is None)):
        stop = f"the targets are met; {left} posture{'s are' if left > 1 else ' is'} left"
        stop = stop if left else "every posture of the plan is measured"
    return state, Verdict(
        posture=posture,
        verdict=verdict,
        findings=tuple(sorted(findings, key=lambda finding: SERIOUS_FIRST.index(finding.result))),
        next=next_posture(model, state, verdict == OK),
        standard_errors=dict(zip(model.nominal.parameters.names, errors.tolist(), strict=True)),
        stop=stop,
        left=left,
        onset=None if state.fault is None else state.fault.posture,
        time=None if model.window is None else float(row.time[0]),
    )


def _without_noise(model: DayModel, state: WatchState, row: Measurements, columns: RowColumns) -> RowColumns:
    """Return the columns of a row at the readings without the errors of cells that the row shows."""
    shown = state.belief.updated(state.belief.predict(model, columns)).mean[model.lasting][-len(CELLS) :]
    return row_columns(model, row, model.noise.cell * shown[None]).row(0)


def _judge(
    model: DayModel, state: WatchState, columns: RowColumns, planned: int, kept: float
) -> tuple[WatchState, str, list[Finding]]:
    """Compare a plausible row with the model of the day and take it in if it fits."""
    posture, findings = model.number(planned), []
    innovation = state.belief.predict(model, columns)
    if state.fault is not None:
        state, change = alarm.still_there(model, state, innovation)
        findings = [change]
        if state.fault is not None:
            return state.marked(planned, AGAIN), CHANGED, findings
    here = columns.about(state.belief.mean[: model.parameters])
    again = alarm.repeat_probability(model, state, here, posture)
    alone = float(chi2_sf(innovation.chi_square, innovation.freedom))
    changes = state.changes.with_row(innovation, state.count, model.ramps)
    sudden = float(changes.ratio[changes.onset.argmax()].max())  # of one row alone
    unlikely = alone < alarm.level(model, "row") or again < alarm.level(model, "repeat")
    if unlikely or sudden > alarm.largest_ratio(model):
        findings = [_odd(innovation, alone, again), *findings]
        state = alarm.fault_of_odd_rows(model, state.marked(planned, AGAIN), innovation, posture)
        odd = REPEAT if model.window is None else ODD
        verdict = odd if state.fault is None else CHANGED
    else:
        state = replace(
            state.remembered(planned).marked(planned, MEASURED),
            odd=(),
            changes=changes,
            belief=state.belief.updated(innovation),
            information=state.information.with_posture(model, columns, kept),
            earlier=state.earlier | ({posture: (state.stance, here)} if model.window is None else {}),
            count=state.count + 1,
        )
        state = alarm.fault_of_changes(model, state)
        verdict = OK if state.fault is None else CHANGED
    told = [] if state.fault is None else [alarm.noticed(model, state.fault)]
    return state, verdict, [*told, *findings]


def _odd(innovation: Innovation, alone: float, again: float) -> Finding:
    """Tell of a posture that does not fit, by the channel with the largest r.m.s. innovation."""
    share = innovation.value / np.sqrt(np.diag(innovation.covariance))
    misfit = {name: float(np.sqrt((share[ROWS[name]] ** 2).mean())) for name in CHANNELS}
    channel, size = max(misfit.items(), key=lambda each: each[1])
    if again < alone:
        return Finding(
            "repeats",
            "fail",
            f"differs from its repeat (p = {number(again, '.1g')})",
            "repeats that agree within the stated noise",
            f"channel {channel}",
            "Measure it again; if it differs again, look for what moved.",
            again,
        )
    return Finding(
        "prediction",
        "fail",
        f"{number(size, '.1f')} s.d. from the prediction in channel {channel} (p = {number(alone, '.1g')})",
        "readings as the postures before predict them",
        f"channel {channel}",
        "Measure it again; if it does not fit again, something has changed.",
        alone,
    )
