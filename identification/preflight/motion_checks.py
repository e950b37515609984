"""Preflight of a robot that moves: clock, segments, clipped readings, lag of the contact sensors."""

import numpy as np

from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.center_of_pressure import center_of_pressure, contact_pressure
from tulip_testbed.identification.inertial_wrench import INERTIA_SD
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.preflight.finding import Finding, few, skipped
from tulip_testbed.identification.residual_noise import noise_of, whitening
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.measurements.logs.series_reduction import LIFTED, unloaded
from tulip_testbed.measurements.trajectory import runs

LATE = 1.5  # steps of the clock, from which on a sample is missed
MISSED, MOST_MISSED = 0.001, 0.05  # shares of the samples
CLIPPED = 20  # samples in a row at the largest or the smallest reading
MOST_LAG, DETERMINED = 0.01, 0.02  # s; the largest s.e. of a lag that says something
# Of the noise of a row's centre of pressure, by which CAD's doubt of the inertias then moves it.
FAST = 1 / INERTIA_SD
TOO_FAST = (
    f"CAD's inertias, which may be {100 * INERTIA_SD:.0f} % wrong, matter more than the noise: plan a slower "
    "motion, or rely on what it shows of the inertias."
)
BLOCK = 4.0  # s: errors of neighbouring rows are alike


def samples_of(samples: Measurements, window: float) -> list[Finding]:
    """Check the samples of a motion, which are reduced to windows [s]."""
    return [_sampling(samples), _segments(samples, window), _feet(samples), _saturation(samples)]


def _sampling(m: Measurements) -> Finding:
    steps = [(np.diff(m.time[rows]), rows.start) for rows in runs(m.posture) if rows.stop - rows.start > 1]
    if not steps:
        return skipped("sampling", "no segment has two samples")
    step = float(np.median(np.concatenate([some for some, _ in steps])))
    gaps = sum((some > LATE * step).sum() for some, _ in steps)
    missed = sum(float((some[some > LATE * step] / step - 1).sum()) for some, _ in steps) / len(m)
    longest, row = max((float(some.max()), start + int(some.argmax())) for some, start in steps)
    return Finding(
        "sampling",
        "fail" if missed > MOST_MISSED else "warn" if missed > MISSED else "pass",
        f"{1 / step:.4g} Hz, {gaps} gaps, {100 * missed:.2g} % of the samples missed",
        f"at most {100 * MISSED:g} %",
        f"longest: {longest:.3g} s after row {row + 1} (segment {m.posture[row]})",
        "Log without losses, or end a segment at a gap.",
    )


def _segments(m: Measurements, window: float) -> Finding:
    short = [
        f"segment {m.posture[rows.start]}: {np.ptp(m.time[rows]):.2g} s"
        for rows in runs(m.posture)
        if np.ptp(m.time[rows]) < window
    ]
    return Finding(
        "segments",
        "warn" if short else "pass",
        f"{len(short)} of {len(runs(m.posture))} are shorter than a window",
        f"none below {window:g} s",
        "; ".join(few(short)),
        "Join segments that are one motion; short ones give no rows.",
    )


def _feet(m: Measurements) -> Finding:
    """Find samples in which a foot that stands lifted; windows with such a sample give no row."""
    lost = unloaded(m)
    where = [f"segment {m.posture[rows.start]}: {lost[rows].sum()}" for rows in runs(m.posture)]
    return Finding(
        "feet loaded",
        "warn" if lost.mean() > MISSED else "pass",
        f"in {100 * lost.mean():.2g} % of the samples a foot that stands carries hardly anything",
        f"at most {100 * MISSED:g} % with less than {100 * LIFTED:g} % of the weight",
        "; ".join(few([text for text in where if not text.endswith(": 0")])),
        "Such windows give no rows: look for a foot that lifted, or for a support that is stated wrongly.",
    )


def _saturation(m: Measurements) -> Finding:
    """Find contact channels that stay at their largest or smallest reading, of feet that stand."""
    stands = feet_in_contact(m.support)
    readings = m.cell_forces.reshape(len(m), 2, -1) if m.wrenches is None else m.wrenches
    names = [name for name in m.columns() if name.startswith(("cell.", "wrench.", "cop."))]
    worst: list[tuple[int, str]] = []
    for k, name in enumerate(names):
        side, channel = divmod(k, readings.shape[2])
        values = readings[stands[:, side], side, channel]
        for end in (values.max(initial=-np.inf), values.min(initial=np.inf)):
            at_end = [one.stop - one.start for one in runs(values == end) if values[one.start] == end]
            if max(at_end, default=0) >= CLIPPED and np.ptp(values) > 0:
                worst.append((max(at_end), f"{name}: {max(at_end)} samples at {end:g}"))
    return Finding(
        "saturation",
        "warn" if worst else "pass",
        f"{len(worst)} channels stay at their largest or smallest reading",
        f"at most {CLIPPED - 1} samples in a row",
        "; ".join(few([text for _, text in sorted(worst, reverse=True)])),
        "Check the range of the sensor and of its amplifier.",
    )


def rows_of(m: Measurements, nominal: Nominal) -> list[Finding]:
    nominal = nominal_robot(nominal.robot, common_support(m.support))
    observed = observe(m, nominal)
    return [_lag(m, nominal, observed), _inertial_part(observed)]


def _inertial_part(observed: Observation) -> Finding:
    """Compare what accelerations add to the centre of pressure with its noise."""
    noise = noise_of(observed)
    if not noise.cell:
        return skipped("inertial part", "the contact readings have no stated noise")
    own = whitening(observed, observed.nominal.value, noise).own[:, :2, :2]
    sd = float(np.sqrt(np.trace(own, axis1=1, axis2=2).mean() / 2))
    added = float(np.sqrt((observed.motion.by_cad[:, :2] ** 2).mean()))
    return Finding(
        "inertial part",
        "warn" if added > FAST * sd else "pass",
        f"accelerations move the centre of pressure by {1e3 * added:.2g} mm r.m.s., "
        f"{added / sd:.2g} of the noise ({1e3 * sd:.2g} mm)",
        f"at most {FAST:.1f} of the noise",
        "inertial forces of CAD",
        TOO_FAST,
    )


def _lag(m: Measurements, nominal: Nominal, observed: Observation) -> Finding:
    """Estimate by how much the contact sensors are behind the encoders.

    In a window the mean of a late centre of pressure is that of the present one, by CAD, less the lag times
    its speed. A part of the centre of mass and of its acceleration is estimated too, and a constant of every
    placement. The standard error is that of a jackknife over blocks of 4 s.
    """
    assert m.joint_rates is not None
    assert m.joint_accelerations is not None
    slope = nominal.parameters.slope_along(nominal.value, m.joint_angles, m.support)
    place = nominal.center_of_mass(m.joint_angles, m.support)
    speed, faster = (np.einsum("mak,mk->ma", slope, v) for v in (m.joint_rates, m.joint_accelerations))
    added = observed.shift
    if len(m) < 2:
        return skipped("lag of contacts", "the motion is too short")
    time = m.time if np.isfinite(m.time).all() else np.arange(len(m)) * np.nanmedian(m.window)
    steps = np.diff(time)
    for rows in runs(np.cumsum(np.append(False, steps > LATE * np.median(steps)))):
        if rows.stop - rows.start > 1:
            speed[rows] += np.gradient(added[rows], time[rows], axis=0)
    columns = np.zeros((len(m), 2, 5))
    columns[..., 0] = -speed
    for axis in range(2):
        columns[:, axis, 1 + axis], columns[:, axis, 3 + axis] = place[:, axis], faster[:, axis]
    if m.contacts is None:
        off = center_of_pressure(m) - place - added
    else:  # without the part of motion
        off = contact_pressure(observe(m, nominal)).center - place
    both = np.concatenate([columns, off[..., None]], axis=2)
    _, number = np.unique(m.placement, return_inverse=True)
    means = np.array([both[number == k].mean(axis=0) for k in range(number.max() + 1)])
    both = both - means[number]
    _, block = np.unique(np.floor(time / BLOCK), return_inverse=True)
    squares = np.zeros((block.max() + 1, 6, 6))
    np.add.at(squares, block, both.mT @ both)
    whole = squares.sum(axis=0)
    if len(squares) < 5 or np.linalg.matrix_rank(whole[:5, :5]) < 5:
        return skipped("lag of contacts", "the motion is too short")
    late = float(np.linalg.solve(whole[:5, :5], whole[:5, 5])[0])
    each = np.array([np.linalg.solve((whole - one)[:5, :5], (whole - one)[:5, 5])[0] for one in squares])
    sd = float(np.sqrt((len(each) - 1) * each.var()))
    if sd > DETERMINED:
        known = f"to {1e3 * sd:.0f} ms only" if sd < 1 else "not at all"
        return skipped("lag of contacts", f"the motion determines the lag {known}")
    return Finding(
        "lag of contacts",
        "warn" if abs(late) - 2 * sd > MOST_LAG else "pass",
        f"{1e3 * late:.0f} ms behind the encoders (s.e. {1e3 * sd:.0f} ms)",
        f"within {1e3 * MOST_LAG:.0f} ms and two s.e.",
        advice="Synchronise the clocks, or shift the contacts' time; filter angles and contacts alike.",
    )
