"""Preflight: sensors that are stuck, saturated, unconnected or too coarse, and understated noise."""

from collections.abc import Iterator

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.identification.center_of_pressure import center_of_pressure, contact_pressure
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.preflight.finding import (
    Finding,
    bonferroni,
    few,
    result_of,
    row_name,
    worst_of,
)
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.measurements.trajectory import runs

LEAST_TIES, TIED_SHARE = 3, 0.05  # number and share of rows at the same extreme that count as a fault
STANDING = 0.5  # of the weight; the cells carry more in every posture
UNLOADED = 0.01  # of the weight; a cell that never carries more is not under the board
STEADY, LACKING = 0.002, 0.03  # of the weight: a dead cell's readings, and what the sum then lacks; assumed
PULLING_WARN, PULLING_FAIL = 0.05, 0.2  # of the weight; a board's tare explains the first (8.6 N of 226)
SAME_ANGLE, MOVED_CENTER = 1e-9, 0.005  # rad between rows, and m; a log that goes on repeats its last angles
UNSTATED_NOISE = 0.01  # of the weight, assumed without a stated cell_sd
Faults = Iterator[tuple[str, str, str]]  # result, place and words
STEPS = tuple(sorted((k * 10.0**n for n in range(-6, 3) for k in (1, 2, 5)), reverse=True))


def stuck(measurements: Measurements, nominal: Nominal) -> Finding:
    """Find readings at a constant extreme or repeated: saturated, frozen or pasted."""
    m = measurements
    faults = [*_constant(m), *_extremes(m), *_copies(m), *_frozen(m, nominal)]
    runs = [
        (name, *longest_run(values, np.ones(max(len(values) - 1, 0), dtype=bool)))
        for name, values in _contact_columns(m)
    ]
    if m.command is not None:
        step = 10 * (m.sensors.encoder_sd or 1e-3)
        for k, (name, values) in enumerate(_columns("q", m.joints, m.joint_angles)):
            runs.append((name, *longest_run(values, np.abs(np.diff(m.command[:, k])) > step)))
    p_value = bonferroni([chance for _, _, chance in runs])
    faults += [
        (result_of(min(1.0, chance * len(runs))), name, f"{name} repeats a value in {length} successive rows")
        for name, length, chance in runs
        if result_of(min(1.0, chance * len(runs))) != "pass"
    ]
    return Finding(
        "stuck readings",
        worst_of([result for result, _, _ in faults]),
        "; ".join(few([text for _, _, text in faults])) or "every sensor's readings differ between postures",
        "no sensor at one value, no cell at one extreme, no row or column twice",
        ", ".join(few(list(dict.fromkeys(place for _, place, _ in faults)))),
        "Look for a saturated amplifier or converter, a loose plug, a frozen log, a row or column pasted "
        "twice; a joint that was not moved gives no information about its links.",
        p_value,
    )


def cell_loads(measurements: Measurements) -> Finding:
    """Find cells that never carry a load, and cells that pull more than a board weighs."""
    m = measurements
    total = m.cell_forces.sum(axis=1)
    weight = float(np.median(total))
    share = m.cell_forces / weight
    idle = [cell for cell, most in zip(CELLS, np.abs(share).max(axis=0), strict=True) if most < UNLOADED]
    row, cell = np.unravel_index(share.argmin(), share.shape)
    pull = -float(share[row, cell])
    noise = 4 * (m.sensors.cell_sd or UNSTATED_NOISE * weight) / weight
    texts = [f"cell.{name} never carries {100 * UNLOADED:.0f} % of the weight" for name in idle]
    results = ["fail"] * len(idle)
    where = ", ".join(f"cell.{name}" for name in idle)
    if dead := _dead(m, weight):
        results.append("fail")
        texts = dead
        where = where or dead[0].partition(":")[0]
    light = np.flatnonzero(total < STANDING * weight)
    if light.size:
        results.append("fail")
        texts.append(f"the cells sum to {total[light[0]]:.1f} N in {row_name(m, int(light[0]))}")
        where = where or row_name(m, int(light[0]))
    if pull > PULLING_WARN + noise:
        results.append("fail" if pull > PULLING_FAIL + noise else "warn")
        texts.append(f"cell.{CELLS[cell]} pulls with {pull * weight:.1f} N in {row_name(m, int(row))}")
        where = where or f"cell.{CELLS[cell]}"
    lowest = f"lowest reading {m.cell_forces.min():.1f} N (less than 0: part of the board's tare)"
    return Finding(
        "cell loads",
        worst_of(results),
        "; ".join(texts) or lowest,
        f"every cell loaded, none below {-(PULLING_WARN + noise) * weight:.0f} N (a board's share)",
        where,
        "Check plug, sign and tare of the cell, a board on three corners, and a foot beyond its cells; "
        "leave out placements in which a cell is dead.",
        gross=bool(dead),
    )


def _dead(m: Measurements, weight: float) -> list[str]:
    """Find cells that read one value in all postures of a placement where the sum is not the weight.

    Zero is no load that stays by chance. Of other readings only one may be steady.
    """
    noise = m.sensors.cell_sd or UNSTATED_NOISE * weight
    known = weight if m.weighed_mass is None else m.weighed_mass[0] * m.gravity
    level, off = STEADY * weight + 6 * noise, m.cell_forces.sum(axis=1) - known
    found: dict[int, list[int]] = {}
    count = 0
    for place in np.unique(m.placement).tolist():
        rows = m.placement == place
        lacking = np.sqrt((off[rows] ** 2).mean())
        untested = rows.sum() < LEAST_TIES or (m.support[rows] != "double").any()
        if untested or lacking < max(LACKING * weight, 4 * noise * np.sqrt(len(CELLS))):
            continue
        count += 1
        spread, most = np.ptp(m.cell_forces[rows], axis=0), np.abs(m.cell_forces[rows]).max(axis=0)
        zero = np.flatnonzero((most < level) & (off[rows].mean() < -0.5 * lacking))
        first, second = np.partition(spread, 1)[:2]
        steady = zero if zero.size else np.flatnonzero((spread == first) & (first < level < second / 2))
        for cell in steady.tolist():
            found.setdefault(cell, []).append(place)
    return [
        f"cell.{CELLS[cell]} is dead in placement {', '.join(few(list(map(str, places))))}: it reads about "
        f"{m.cell_forces[np.isin(m.placement, places), cell].mean():.2g} N in all postures, and the sum of "
        "the cells is not the weight"
        for cell, places in found.items()
        if 2 * len(places) >= count  # another cause leaves some steady by chance
    ]


def resolution(measurements: Measurements) -> Finding:
    """Compare the stated s.d. with the least that rounding and noise within a window allow."""
    m, sheet, texts, where = measurements, measurements.sensors, [], []
    for key, prefix, stated, step, values, spread in (
        ("encoder_sd", "q", sheet.encoder_sd, sheet.encoder_resolution, m.joint_angles, m.joint_angles_sd),
        ("cell_sd", "cell", sheet.cell_sd, sheet.cell_resolution, m.cell_forces, m.cell_forces_sd),
    ):
        if stated == 0:
            texts.append(f"sensors.{key} is 0, which is impossible: the checks that need it are skipped")
            where.append(f"sensors.{key}")
        if not stated or not values.size:
            continue
        noise = _median(spread)
        rounding = rounding_sd(step or 0.0, noise)
        written = decimal_step(values)
        count = _median(m.samples)
        mean_noise = noise / np.sqrt(count) if np.isfinite(noise) and np.isfinite(count) else 0.0
        for source, least in (
            (f"a resolution of {step:g} at noise {number(noise, '.2g')}" if step else "", rounding),
            (f"{prefix}.* written in steps of {written:g}", written / np.sqrt(12)),
            (f"noise of {number(noise, '.2g')} over {count:g} samples", mean_noise),
        ):
            if source and least > 1.1 * stated:
                texts.append(
                    f"{source} gives an s.d. of {number(least, '.2g')}, "
                    f"but sensors.{key} states {number(stated, '.2g')}"
                )
                where.append(f"sensors.{key}")
    return Finding(
        "stated noise",
        "warn" if texts else "pass",
        "; ".join(texts) or "stated s.d. no smaller than rounding and noise allow",
        "s.d. of the averaged readings as they are in the table",
        ", ".join(dict.fromkeys(where)),
        "Write more digits, average longer, or state a larger s.d. (null if unknown).",
    )


def longest_run(values: np.ndarray, moved: np.ndarray) -> tuple[int, float]:
    """Return the longest run of one value in successive rows, and a bound on its probability by chance.

    Only rows count at which the value should have changed from the row before, (m - 1,) bool.
    """
    same = (values[1:] == values[:-1]) & moved
    best = 1 + max((rows.stop - rows.start for rows in runs(same) if same[rows.start]), default=0)
    _, counts = np.unique(values, return_counts=True)
    share = counts / len(values)
    alike = float((share**2).sum())
    return best, 1.0 if best == 1 else min(1.0, len(values) * alike ** (best - 1))


def decimal_step(values: np.ndarray) -> float:
    """Return the coarsest of 1, 2, 5 times a power of ten that divides all values; 0 below 1e-6."""
    for step in STEPS:
        parts = values / step
        if (np.abs(parts - np.round(parts)) < 1e-9 * np.maximum(np.abs(parts), 1)).all():
            return step
    return 0.0


def rounding_sd(step: float, noise: float) -> float:
    """Return the s.d. of a mean of many samples by rounding, dithered by noise (Widrow's series)."""
    if step == 0:
        return 0.0
    k = np.arange(1, 200)
    noise = noise if np.isfinite(noise) else 0.0
    terms = np.exp(-4 * (np.pi * k * noise / step) ** 2) / (2 * np.pi**2 * k**2)
    return float(step * np.sqrt(terms.sum()))


def _columns(prefix: str, names: tuple[str, ...], values: np.ndarray) -> list[tuple[str, np.ndarray]]:
    return [(f"{prefix}.{name}", values[:, k]) for k, name in enumerate(names)]


def _contact_columns(m: Measurements) -> list[tuple[str, np.ndarray]]:
    """List the readings of cells, or of wrench sensors while their foot stands, by the columns' names."""
    if m.contacts is None or m.wrenches is None:
        return _columns("cell", CELLS, m.cell_forces)
    stands = feet_in_contact(m.support).T
    return [
        (f"wrench.{plate}.{channel}", m.wrenches[stands[p], p, k])
        for p, plate in enumerate(PLATES)
        for k, channel in enumerate(m.contacts.channels)
        if stands[p].any()
    ]


def _constant(m: Measurements) -> Faults:
    """Find channels with a single value; a joint may be at rest on purpose, a cell may not."""
    if len(m) == 1:
        return
    for k, (name, values) in enumerate(_columns("q", m.joints, m.joint_angles)):
        if m.joints[k] in m.constant_joints or np.ptp(values) > 0:
            continue
        sent = m.command is not None and np.ptp(m.command[:, k]) > 10 * (m.sensors.encoder_sd or 1e-3)
        text = f"{name} reads {values[0]:g} in all postures"
        yield ("fail", name, f"{text}, though it was commanded to move") if sent else ("warn", name, text)
    for name, values in _contact_columns(m):
        if len(values) > 1 and np.ptp(values) == 0:
            yield "fail", name, f"{name} reads {values[0]:g} N in all postures"


def _frozen(m: Measurements, nominal: Nominal) -> Faults:
    """Find rows of a motion in which no joint changes and the centre of pressure does."""
    if m.joint_rates is None:
        return
    rests = np.abs(np.diff(m.joint_angles, axis=0)).max(axis=1) < SAME_ANGLE
    if not rests.any():
        return
    center = center_of_pressure(m) if m.contacts is None else contact_pressure(observe(m, nominal)).center
    for some in runs(rests):
        moved = float(np.ptp(center[some.start : some.stop + 1], axis=0).max())
        if rests[some.start] and moved > MOVED_CENTER:
            place = f"rows {some.start + 1} to {some.stop + 1}"
            text = f"{place}: no joint changes, while the centre of pressure moves by {1e3 * moved:.0f} mm"
            yield "fail", place, text


def _extremes(m: Measurements) -> Faults:
    for name, values in _contact_columns(m):
        for extreme, kind in ((values.max(), "largest"), (values.min(), "smallest")):
            ties = int((values == extreme).sum())
            if np.ptp(values) > 0 and ties >= max(LEAST_TIES, TIED_SHARE * len(m)):
                yield "fail", name, f"{name} reads its {kind} value {extreme:g} N in {ties} postures"


def _copies(m: Measurements) -> Faults:
    columns = _contact_columns(m)
    for k, (name, values) in enumerate(columns):
        for other, others in columns[:k]:
            if len(m) > 1 and np.array_equal(values, others):
                yield "fail", name, f"{other} and {name} are the same column"
    readings = m.cell_forces if m.wrenches is None else np.nan_to_num(m.wrenches.reshape(len(m), -1))
    rows = np.column_stack([m.joint_angles, readings])
    _, first, back = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    earlier = first[back.ravel()]
    for row in np.flatnonzero(earlier != np.arange(len(m))):
        yield "fail", f"row {row + 1}", f"rows {earlier[row] + 1} and {row + 1} hold the same readings"


def _median(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else np.nan
