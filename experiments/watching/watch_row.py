"""Judge a row as soon as it is there: by itself, and against everything that was measured before it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching.alarm import OK, judge, level
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.row_columns import RowColumns, row_columns
from tulip_testbed.experiments.watching.watch_state import AGAIN, MEASURED, OPEN, WatchState, begin_row
from tulip_testbed.identification.contact_readings import ROCKING
from tulip_testbed.identification.preflight import settling
from tulip_testbed.identification.preflight.finding import Finding
from tulip_testbed.identification.preflight.readings import cell_loads
from tulip_testbed.identification.preflight.stance_checks import feet_on_plates, load_in_soles, plate_poses
from tulip_testbed.identification.preflight.units import joint_limits, units
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS

BREAK = 3600.0  # s: a longer time between two rows is a break, or a clock that jumped
USUAL = 30  # rows from which the usual s.d. within a window is taken
LEAST_ROWS = 5  # of them, from which a window is compared
LEAST_SPEED = 1e-4  # rad/s: slower is at rest
MOST_OFF = 0.1  # rad, of a joint from its planned angle: drives sag by 0.02 rad in the simulated laboratory
UNPLANNED, UNUSABLE, NOT_SETTLED = "not in the plan", "unusable", "not settled"
TOLD = ("result", "seen", "expected", "where", "advice")  # of a finding in JSON
SERIOUS_FIRST = ("fail", "warn", "pass")


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
    posture, time = int(row.posture[0]), float(row.time[0])
    planned = planned_row(model, state, posture, int(row.placement[0]))
    if planned is None:
        kind = "posture" if model.held else "placement"
        seen, wanted = f"{kind} {getattr(row, kind)[0]}", f"a {kind} of the plan"
        verdict, findings = UNPLANNED, [Finding(kind, "fail", seen, wanted, advice="Look at its number.")]
    elif time == state.time and planned == state.row:
        # Its noise is the same, so that it would count for more than it says.
        where, wanted = f"posture {posture}", "a row for every measurement"
        seen = f"{where} at the same time as in the row before"
        advice = "Delete one of the two rows."
        verdict, findings = UNUSABLE, [Finding("order", "fail", seen, wanted, where, advice)]
    else:
        verdict, findings = _by_itself(model, state, row, planned)
        kept = model.shares[0] * model.kept(time - state.time)
        state = begin_row(model, state, row, planned)
        if not verdict:
            columns = _columns(model, state, row)
            spreads = np.concatenate([state.spreads, spreads_of(row)[None]])[-USUAL:]
            state, verdict, told = judge(model, replace(state, spreads=spreads), columns, posture, kept)
            findings = [*told, *findings]
        state = state.marked(planned, MEASURED if verdict == OK else AGAIN)
    errors = state.information.standard_errors()
    met = targets is not None and np.isfinite(targets).any() and (errors <= targets).all()
    left, stop = int((state.done != MEASURED).sum()), ""
    if state.fault is None and model.held and left == 0:
        stop = "every posture of the plan is measured"
    elif state.fault is None and met:
        more = f"; {left} posture{'s are' if left > 1 else ' is'} left" if model.held else ""
        stop = f"the targets are met{more}"
    return state, Verdict(
        posture=posture,
        verdict=verdict,
        findings=tuple(sorted(findings, key=lambda finding: SERIOUS_FIRST.index(finding.result))),
        next=next_posture(model, state, verdict == OK) if model.held else None,
        standard_errors=dict(zip(model.nominal.parameters.names, errors.tolist(), strict=True)),
        stop=stop,
        left=left,
        onset=None if state.fault is None else state.fault.posture,
        time=None if model.held else time,
    )


def planned_row(model: DayModel, state: WatchState, posture: int, placement: int) -> int | None:
    """Return the plan's row of a posture; None: not in the plan.

    A row of a motion is its own number, if the plan has its placement. Of a posture that the plan repeats,
    that is one of the same placement if there is one, and of these one that is not measured.
    """
    if not model.held:
        return posture if placement in model.plan.placement else None
    rows = np.flatnonzero(model.plan.posture == posture).tolist()
    rows = [row for row in rows if model.plan.placement[row] == placement] or rows
    for mark in (OPEN, AGAIN):
        if wanted := [row for row in rows if state.done[row] == mark]:
            return wanted[0]
    return rows[-1] if rows else None


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
    after = (np.arange(len(plan)) > state.row) & (done == OPEN)
    for rows in (here & after, here & (done == AGAIN), after, done != MEASURED):
        if rows.any():
            return int(plan.posture[rows.argmax()])
    return None


def _by_itself(
    model: DayModel, state: WatchState, row: Measurements, planned: int
) -> tuple[str, list[Finding]]:
    """Return the verdict if a row by itself cannot be used, else "", and what is odd about it."""
    nominal, where = model.nominal, f"{model.unit} {row.posture[0]}"
    order, findings = _out_of_order(model, state, row, planned) if model.held else [], []
    in_units = units(row, nominal)
    if in_units.result == "fail":
        return UNUSABLE, [*order, in_units]
    checks = [joint_limits(row, nominal), cell_loads(row)]
    if row.support[0] == "double":
        checks += [plate_poses(row), feet_on_plates(row, nominal), load_in_soles(row, nominal)]
    for finding in checks:
        # A cell that hardly bears anything in one posture is nothing unusual; over a day it would be.
        usual = finding.name == "cell loads" and "never carries" in finding.seen
        chance = finding.p_value is not None and finding.p_value >= level(model, "row")
        if finding.result in ("warn", "fail") and not usual and not chance:
            findings.append(finding)
    if any(finding.result == "fail" for finding in findings):
        return UNUSABLE, [*order, *findings]
    if not model.held:  # no posture of the plan, and no rest
        return "", findings
    off = row.joint_angles[0] - model.plan.joint_angles[planned]
    worst = int(np.abs(off).argmax())
    if abs(off[worst]) > MOST_OFF:
        seen = f"q.{row.joints[worst]} is {number(float(off[worst]), '+.2g')} rad from the plan"
        wanted = f"every joint within {MOST_OFF:g} rad of its planned angle"
        advice = "Look for another posture under this number, or an encoder that slipped."
        return UNUSABLE, [*order, Finding("posture", "fail", seen, wanted, where, advice), *findings]
    if (unrest := _unrest(row, state.spreads)) is None:
        return "", [*order, *findings]
    return NOT_SETTLED if unrest.result == "fail" else "", [*order, unrest, *findings]


def _out_of_order(model: DayModel, state: WatchState, row: Measurements, planned: int) -> list[Finding]:
    """Return what is odd about placement, order and time of a posture."""
    where, findings = f"posture {row.posture[0]}", []
    if (placement := int(row.placement[0])) != (expected := int(model.plan.placement[planned])):
        wanted = f"placement {expected}, as in the plan"
        advice = "Correct the number if the plates were not laid again."
        findings.append(Finding("placement", "warn", f"placement {placement}", wanted, where, advice))
    later = float(row.time[0]) - state.time
    if -BREAK <= later < 0 <= state.row - planned:
        seen, wanted = f"{number(-later, '.0f')} s before the row before it", "rows in the order of time"
        findings.append(Finding("order", "warn", seen, wanted, where, "The row is used as it is."))
    elif np.isfinite(later) and not 0 <= later <= BREAK:
        seen = f"the time jumps {'back' if later < 0 else 'ahead'} by {number(abs(later), '.0f')} s"
        wanted = f"times that increase, by less than {BREAK:.0f} s"
        look = (
            "After a break look for what changed, else correct the clock. The foot counts as put down again."
        )
        findings.append(Finding("clock", "warn", seen, wanted, where, look))
    return findings


def _unrest(row: Measurements, usual: np.ndarray) -> Finding | None:
    """Compare the s.d. within the window with those of the rows before; None: nothing is unusual.

    Args:
        usual: `spreads_of` the last rows, (k, n_joints + 9).
    """
    spreads, known = spreads_of(row), np.isfinite(usual).sum(axis=0) >= LEAST_ROWS
    if not (known & np.isfinite(spreads)).any():
        return None
    typical = np.full(len(spreads), np.nan)
    typical[known] = np.nanmedian(usual[:, known], axis=0)
    typical = np.append(settling.unsteady_from(row, typical[:-1]), np.hypot(typical[-1], LEAST_SPEED))
    ratios = spreads / typical
    worst, ratio = int(np.nanargmax(ratios)), float(np.nanmax(ratios))
    if ratio <= settling.UNSTEADY_WARN:
        return None
    names = [*(f"q_std.{joint}" for joint in row.joints), *(f"cell_std.{cell}" for cell in CELLS), "speed"]
    return Finding(
        "settled",
        "fail" if ratio > settling.UNSTEADY_FAIL else "warn",
        f"{names[worst]} is {number(ratio, '.3g')} times its usual value",
        f"at most {settling.UNSTEADY_WARN:g} times (fails at {settling.UNSTEADY_FAIL:g})",
        f"posture {row.posture[0]}",
        "Wait longer before averaging, and measure the posture again.",
    )


def spreads_of(row: Measurements) -> np.ndarray:
    """Return the s.d. within the window of joints and cells, and the speed, (n_joints + 9,); NaN: unknown."""
    speed = np.nan if row.speed is None else float(row.speed[0])
    return np.concatenate([row.joint_angles_sd[0], row.cell_forces_sd[0], [speed]])


def rocking(row: Measurements, usual: np.ndarray) -> np.ndarray:
    """Return which boards rock within a row of a motion, (2,) bool, see `Observation.on_four_cells`.

    Args:
        usual: `spreads_of` the last rows, (k, n_joints + 9).
    """
    cells = slice(len(row.joints), -1)
    known = usual[:, cells] if len(usual) >= LEAST_ROWS else np.full((1, len(CELLS)), np.inf)
    before = np.median(known.reshape(-1, 2, 4).max(axis=2), axis=0)
    return row.cell_forces_sd[0].reshape(2, 4).max(axis=1) > ROCKING * before


def _columns(model: DayModel, state: WatchState, row: Measurements) -> RowColumns:
    """Return the columns of a row; in a motion at the readings without the cells' errors that it shows."""
    columns = row_columns(model, row).row(0)
    if model.held:
        return columns
    rocks = rocking(row, state.spreads)
    innovation = state.belief.predict(model, columns.without_twist(rocks))
    shown = state.belief.updated(innovation).mean[model.lasting][-len(CELLS) :]
    return row_columns(model, row, model.noise.cell * shown[None]).row(0).without_twist(rocks)
