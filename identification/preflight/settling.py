"""Preflight: steadiness of the averaged windows."""

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.identification.distributions import t_sf
from tulip_testbed.identification.preflight.finding import Finding, bonferroni, result_of, row_name, skipped
from tulip_testbed.measurements import Measurements, Series
from tulip_testbed.measurements.cells import CELLS

BATCHES = 10  # per half; means of many samples are nearly independent
UNSTEADY_WARN, UNSTEADY_FAIL = 2.0, 5.0  # times the channel's usual s.d. within a window
LEAST_ANGLE, LEAST_FORCE = 1e-6, 1e-3  # rad, N: smaller changes are irrelevant
ADVICE = "Wait longer after each movement before averaging; leave these postures out."


def settling(measurements: Measurements, series: Series | None) -> Finding:
    """Compare the halves of every window; a change below the stated s.d. is harmless."""
    name, m = "settling", measurements
    if series is None:
        return skipped(name, "no series.parquet with the raw readings; see 'steady windows' instead")
    harmless = by_channel(m, m.sensors.encoder_sd or 0.0, m.sensors.cell_sd or 0.0)
    p_values = np.ones((len(m), len(harmless)))
    change = np.zeros_like(p_values)
    evaluated = np.zeros(len(m), dtype=bool)
    for row in range(len(m)):
        readings = series.window(m, row)
        if len(readings) >= 4 * BATCHES:
            change[row], p_values[row] = _halves(readings, harmless)
            evaluated[row] = True
    if not evaluated.any():
        return skipped(name, f"series.parquet has no window with at least {4 * BATCHES} samples")
    row, channel = np.unravel_index(p_values.argmin(), p_values.shape)
    label, size, unit = _channel(m, int(channel), change[row, channel])
    p_value = bonferroni(p_values[evaluated])
    count = int(((p_values * p_values[evaluated].size) < 0.01).any(axis=1).sum())
    return Finding(
        name,
        result_of(p_value),
        f"{count} of {int(evaluated.sum())} windows still change; most: {label} by "
        f"{number(size, '+.3g')} {unit} from the first half to the second",
        "no change beyond the stated s.d. of an averaged reading",
        row_name(m, int(row)),
        ADVICE,
        p_value,
    )


def series_agrees(measurements: Measurements, series: Series | None) -> Finding:
    """Compare the averages of the raw readings with the table."""
    name, m = "series and table", measurements
    if series is None:
        return skipped(name, "no series.parquet")
    worst, where, missing = 0.0, "", 0
    table = np.column_stack([m.joint_angles, m.cell_forces])
    scale = by_channel(m, m.sensors.encoder_sd or 1e-3, m.sensors.cell_sd or 1.0)
    for row in range(len(m)):
        readings = series.window(m, row)
        if not len(readings):
            missing += 1
            continue
        off = np.abs(readings.mean(axis=0) - table[row])
        ratio = off / np.maximum(scale, 5 * readings.std(axis=0) / np.sqrt(len(readings)))
        if ratio.max() > worst:
            worst = float(ratio.max())
            label, size, unit = _channel(m, int(ratio.argmax()), off[ratio.argmax()])
            where = f"{label}, {row_name(m, row)}: {number(size, '.3g')} {unit} apart"
    seen = f"{len(m) - missing} of {len(m)} postures have raw readings"
    if worst > 1:
        seen += "; their averages are not the table's"
    return Finding(
        name,
        "fail" if worst > 1 else "warn" if missing else "pass",
        seen,
        "raw readings of every window, whose averages are the table's",
        where if worst > 1 else "",
        "Check posture numbers, the clock of t, and which window was averaged.",
    )


def steady_windows(measurements: Measurements) -> Finding:
    """Compare the s.d. within each window with the usual one of that sensor, as a rule of thumb."""
    name, m = "steady windows", measurements
    if m.joint_rates is not None:
        return skipped(name, "the robot moves in all windows")
    spread = np.column_stack([m.joint_angles_sd, m.cell_forces_sd])
    available = np.isfinite(spread).sum(axis=0) >= 3
    if not available.any():
        return skipped(name, "no q_std.* or cell_std.* columns")
    usual = np.full(spread.shape[1], np.nan)
    usual[available] = np.nanmedian(spread[:, available], axis=0)
    frozen = [_channel(m, int(k), 0.0)[0] for k in np.flatnonzero(available & (usual == 0))]
    ratio = np.nan_to_num(spread / unsteady_from(m, usual))
    row, channel = np.unravel_index(ratio.argmax(), ratio.shape)
    worst = float(ratio[row, channel])
    result = "fail" if worst > UNSTEADY_FAIL else "warn" if worst > UNSTEADY_WARN else "pass"
    label, size, unit = _channel(m, int(channel), spread[row, channel])
    seen = f"largest: {label} with {number(size, '.3g')} {unit}, {worst:.1f} times its usual"
    if dead := [label for label in frozen if label.startswith("cell.")]:
        seen += f"; s.d. exactly 0: {', '.join(dead)}"
        result = "warn" if result == "pass" else result
    return Finding(
        name,
        result,
        seen,
        f"within {UNSTEADY_WARN:g} times the sensor's median over the postures",
        row_name(m, int(row)) if worst > UNSTEADY_WARN else ", ".join(dead),
        ADVICE + " An s.d. of 0: leave the column out rather than writing zeros.",
    )


def unsteady_from(m: Measurements, usual: np.ndarray) -> np.ndarray:
    """Return the s.d. within a window that count as usual, of joints and cells, and are never negligible.

    A reading between two steps of a coarse sensor jumps by half a step without movement.
    """
    step = by_channel(m, m.sensors.encoder_resolution or 0.0, m.sensors.cell_resolution or 0.0)
    return np.sqrt(usual**2 + (step / 2) ** 2 + by_channel(m, LEAST_ANGLE, LEAST_FORCE) ** 2)


def _halves(readings: np.ndarray, harmless: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the change from first to second half and the p-value of a change beyond `harmless`, per channel.

    The standard error is that of batch means about a line in each half, so that the change itself does
    not contribute. It is too small if noise is correlated over more than a few hundredths of the window.
    """
    size = len(readings) // (2 * BATCHES)
    batches = readings[: 2 * BATCHES * size].reshape(2, BATCHES, size, -1).mean(axis=2)
    change = batches[1].mean(axis=0) - batches[0].mean(axis=0)
    line = np.linspace(-1, 1, BATCHES)[:, None]
    rest = batches - batches.mean(axis=1, keepdims=True)
    rest -= line * (line * rest).sum(axis=1, keepdims=True) / (line**2).sum()
    dof = 2 * (BATCHES - 2)
    error = np.sqrt((rest**2).sum(axis=(0, 1)) / dof * 2 / BATCHES)
    beyond = np.maximum(np.abs(change) - harmless, 0.0)
    t = np.divide(beyond, error, out=np.where(beyond > 0, np.inf, 0.0), where=error > 0)
    return change, np.where(beyond > 0, 2 * t_sf(t, dof), 1.0)


def by_channel(m: Measurements, of_joints: float, of_cells: float) -> np.ndarray:
    """Return a number for the reading of every joint and of every cell, (n_joints + k,)."""
    return np.repeat([of_joints, of_cells], [len(m.joints), m.cell_forces.shape[1]])


def _channel(m: Measurements, channel: int, value: float) -> tuple[str, float, str]:
    """Return column name, value in a convenient unit, and that unit."""
    if channel < len(m.joints):
        return f"q.{m.joints[channel]}", 1e3 * value, "mrad"
    return f"cell.{CELLS[channel - len(m.joints)]}", value, "N"
