"""Checks that a single row can fail without any model of the day: order, plausible readings, and rest."""

from collections.abc import Iterator

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.watch_state import WatchState
from tulip_testbed.identification.observation import ROCKING
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
UNUSABLE, NOT_SETTLED = "unusable", "not settled"
MOST_OFF = 0.1  # rad, of a joint from its planned angle: drives sag by 0.02 rad in the simulated laboratory


def refused(model: DayModel, state: WatchState, row: Measurements, planned: int | None) -> Finding | None:
    """Refuse a row that is not in the plan or there twice; None: it is neither."""
    where = f"posture {row.posture[0]}"
    if planned is None:
        kind = "posture" if model.window is None else "placement"
        seen = f"{kind} {getattr(row, kind)[0]}"
        return Finding(kind, "fail", seen, f"a {kind} of the plan", "", "Look at its number.")
    if float(row.time[0]) == state.time and planned == state.row:
        # Its noise is the same, so that it would count for more than it says.
        seen, wanted = f"{where} at the same time as in the row before", "a row for every measurement"
        return Finding("order", "fail", seen, wanted, where, "Delete one of the two rows.")
    return None


def order_findings(model: DayModel, state: WatchState, row: Measurements, planned: int) -> Iterator[Finding]:
    """Yield what is odd about placement, order and time of a row."""
    where = f"posture {row.posture[0]}"
    if model.window is not None:
        return
    if (placement := int(row.placement[0])) != (expected := int(model.plan.placement[planned])):
        wanted = f"placement {expected}, as in the plan"
        advice = "Correct the number if the plates were not laid again."
        yield Finding("placement", "warn", f"placement {placement}", wanted, where, advice)
    later = float(row.time[0]) - state.time
    if -BREAK <= later < 0 <= state.row - planned:
        seen = f"{number(-later, '.0f')} s before the row before it"
        advice = "The row is used as it is."
        yield Finding("order", "warn", seen, "rows in the order of time", where, advice)
    elif np.isfinite(later) and not 0 <= later <= BREAK:
        seen = f"the time jumps {'back' if later < 0 else 'ahead'} by {number(abs(later), '.0f')} s"
        expect = f"times that increase, by less than {BREAK:.0f} s"
        advice = (
            "After a break look for what changed, else correct the clock. The foot counts as put down again."
        )
        yield Finding("clock", "warn", seen, expect, where, advice)


def unfit(
    model: DayModel, state: WatchState, row: Measurements, planned: int, level: float
) -> tuple[str, list[Finding]]:
    """Return the verdict if the row alone cannot be used, else "", and what a check below `level` shows."""
    nominal, where, findings = model.nominal, f"{model.unit} {row.posture[0]}", []
    in_units = units(row, nominal)
    if in_units.result == "fail":
        return UNUSABLE, [in_units]
    checks = [joint_limits(row, nominal), cell_loads(row)]
    if bool((row.support == "double").all()):
        checks += [plate_poses(row), feet_on_plates(row, nominal), load_in_soles(row, nominal)]
    for finding in checks:
        # A cell that hardly bears anything in one posture is nothing unusual; over a day it would be.
        usual = finding.name == "cell loads" and "never carries" in finding.seen
        chance = finding.p_value is not None and finding.p_value >= level
        if finding.result in ("warn", "fail") and not usual and not chance:
            findings.append(finding)
    if any(finding.result == "fail" for finding in findings):
        return UNUSABLE, findings
    if model.window is not None:  # no posture of the plan, and no rest
        return "", findings
    off = row.joint_angles[0] - model.plan.joint_angles[planned]
    worst = int(np.abs(off).argmax())
    if abs(off[worst]) > MOST_OFF:
        seen = f"q.{row.joints[worst]} is {number(float(off[worst]), '+.2g')} rad from the plan"
        wanted = f"every joint within {MOST_OFF:g} rad of its planned angle"
        advice = "Look for another posture under this number, or an encoder that slipped."
        return UNUSABLE, [Finding("posture", "fail", seen, wanted, where, advice), *findings]
    unrest = _unrest(row, state.spreads)
    if unrest is not None:
        return NOT_SETTLED if unrest.result == "fail" else "", [unrest, *findings]
    return "", findings


def rocking(row: Measurements, usual: np.ndarray) -> np.ndarray:
    """Return which boards rock within a row of a motion, (2,) bool, see `Observation.on_four_cells`.

    Args:
        usual: `spreads_of` the last rows, (k, n_joints + 9).
    """
    cells = slice(len(row.joints), -1)
    known = usual[:, cells] if len(usual) >= LEAST_ROWS else np.full((1, len(CELLS)), np.inf)
    before = np.median(known.reshape(-1, 2, 4).max(axis=2), axis=0)
    return row.cell_forces_sd[0].reshape(2, 4).max(axis=1) > ROCKING * before


def spreads_of(row: Measurements) -> np.ndarray:
    """Return the s.d. within the window of joints and cells, and the speed, (n_joints + 9,); NaN: unknown."""
    speed = np.nan if row.speed is None else float(row.speed[0])
    return np.concatenate([row.joint_angles_sd[0], row.cell_forces_sd[0], [speed]])


def _unrest(row: Measurements, usual: np.ndarray) -> Finding | None:
    """Compare the s.d. within the window with those of the rows before; None: nothing is unusual.

    Args:
        usual: `spreads_of` the last rows, (k, n_joints + 9).
    """
    spreads, known = spreads_of(row), np.isfinite(usual).sum(axis=0) >= LEAST_ROWS
    if len(usual) < LEAST_ROWS or not (known & np.isfinite(spreads)).any():
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
