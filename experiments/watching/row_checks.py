"""Checks that a single row can fail without any model of the day: order, plausible readings, and rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.watch_state import WatchState
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import Finding
from tulip_testbed.identification.preflight.plate_checks import feet_on_plates, load_in_soles, plate_poses
from tulip_testbed.identification.preflight.readings import cell_loads
from tulip_testbed.identification.preflight.settling import (
    LEAST_ANGLE,
    LEAST_FORCE,
    UNSTEADY_FAIL,
    UNSTEADY_WARN,
    by_channel,
)
from tulip_testbed.identification.preflight.units import joint_limits, units
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS

BREAK = 3600.0  # s: a longer time between two rows is a break, or a clock that jumped
DAY, MOST_DAYS = 86400.0, 2  # s, and a number of them: what is further apart is no day of measurements
USUAL = 30  # rows from which the usual s.d. within a window is taken
LEAST_ROWS = 5  # of them, from which a window is compared
LEAST_SPEED = 1e-4  # rad/s: slower is at rest
MOST_OFF = 0.1  # rad, of a joint from its planned angle: drives sag by 0.02 rad in the simulated laboratory


def order_findings(model: DayModel, state: WatchState, row: Measurements, planned: int) -> list[Finding]:
    """Return what is odd about placement, order and time of a row."""
    findings, where = [], f"posture {row.posture[0]}"
    if (placement := int(row.placement[0])) != (expected := int(model.plan.placement[planned])):
        wanted = f"placement {expected}, as in the plan"
        advice = "Correct the number if the plates were not laid again."
        findings.append(Finding("placement", "warn", f"placement {placement}", wanted, where, advice))
    later = float(row.time[0]) - state.time
    if -BREAK <= later < 0 <= state.row - planned:
        seen = f"{number(-later, '.0f')} s before the row before it"
        advice = "The row is used as it is."
        findings.append(Finding("order", "warn", seen, "rows in the order of time", where, advice))
    elif np.isfinite(later) and not 0 <= later <= BREAK:
        way = "back" if later < 0 else "ahead"
        seen = f"the time jumps {way} by {number(abs(later), '.0f')} s"
        expect = f"times that increase, by less than {BREAK:.0f} s"
        advice = (
            "After a break look for what changed, else correct the clock. The foot counts as put down again."
        )
        findings.append(Finding("clock", "warn", seen, expect, where, advice))
    return findings


def clock_jump(state: WatchState, row: Measurements) -> Finding | None:
    """Refuse a row of another day; None: it is not."""
    days = (float(row.time[0]) - state.time) / DAY
    if not abs(days) > MOST_DAYS:
        return None
    way = "back" if days < 0 else "ahead"
    seen, expected = f"the time jumps {way} by {number(abs(days), '.1f')} days", f"{MOST_DAYS} days at most"
    advice = "Correct the clock; watch another day with a state of its own."
    return Finding("clock", "fail", seen, expected, f"posture {row.posture[0]}", advice)


def plausible(row: Measurements, nominal: Nominal, level: float) -> list[Finding]:
    """Run the checks of the preflight that one row allows; return those that fail or warn.

    Args:
        level: p-value below which a statistical check counts.
    """
    in_units = units(row, nominal)
    if in_units.result == "fail":
        return [in_units]
    checks: list[Callable[[], Finding]] = [lambda: joint_limits(row, nominal), lambda: cell_loads(row)]
    if bool((row.support == "double").all()):
        checks += [
            lambda: plate_poses(row),
            lambda: feet_on_plates(row, nominal),
            lambda: load_in_soles(row, nominal),
        ]
    return [
        finding
        for finding in (check() for check in checks)
        if finding.result in ("warn", "fail")
        # A cell that hardly bears anything in one posture is nothing unusual; over a day it would be.
        and not (finding.name == "cell loads" and "never carries" in finding.seen)
        and (finding.p_value is None or finding.p_value < level)
    ]


def as_planned(row: Measurements, planned: np.ndarray) -> Finding | None:
    """Compare the joint angles with the planned ones, (n_joints,) [rad]; None: they agree."""
    off = row.joint_angles[0] - planned
    worst = int(np.abs(off).argmax())
    if abs(off[worst]) <= MOST_OFF:
        return None
    return Finding(
        "posture",
        "fail",
        f"q.{row.joints[worst]} is {number(float(off[worst]), '+.2g')} rad from the plan",
        f"every joint within {MOST_OFF:g} rad of its planned angle",
        f"posture {row.posture[0]}",
        "Look for another posture under this number, or an encoder that slipped.",
    )


def spreads_of(row: Measurements) -> np.ndarray:
    """Return the s.d. within the window of joints and cells, and the speed, (n_joints + 9,); NaN: unknown."""
    speed = np.nan if row.speed is None else float(row.speed[0])
    return np.concatenate([row.joint_angles_sd[0], row.cell_forces_sd[0], [speed]])


def settled(row: Measurements, usual: np.ndarray) -> Finding | None:
    """Compare the s.d. within the window with those of the rows before; None: nothing is unusual.

    Args:
        usual: `spreads_of` the last rows, (k, n_joints + 9).
    """
    spreads, sheet = spreads_of(row), row.sensors
    # A reading between two steps of a coarse sensor jumps by half a step without movement.
    steps = np.append(by_channel(row, sheet.encoder_resolution or 0.0, sheet.cell_resolution or 0.0), 0.0)
    least = np.append(by_channel(row, LEAST_ANGLE, LEAST_FORCE), LEAST_SPEED)
    known = np.zeros(len(spreads), bool)
    if len(usual):
        known = np.isfinite(spreads) & (np.isfinite(usual).sum(axis=0) >= LEAST_ROWS)
    if not known.any():
        return None
    typical = np.hypot(np.hypot(np.nanmedian(usual[:, known], axis=0), steps[known] / 2), least[known])
    ratios = spreads[known] / typical
    worst, ratio = int(np.flatnonzero(known)[ratios.argmax()]), float(ratios.max())
    if ratio <= UNSTEADY_WARN:
        return None
    names = [*(f"q_std.{joint}" for joint in row.joints), *(f"cell_std.{cell}" for cell in CELLS), "speed"]
    return Finding(
        "settled",
        "fail" if ratio > UNSTEADY_FAIL else "warn",
        f"{names[worst]} is {number(ratio, '.3g')} times its usual value",
        f"at most {UNSTEADY_WARN:g} times (fails at {UNSTEADY_FAIL:g})",
        f"posture {row.posture[0]}",
        "Wait longer before averaging, and measure the posture again.",
    )
