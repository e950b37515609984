"""Preflight: the cells carry the robot's weight, the same in all postures."""

import numpy as np

from tulip_testbed.identification.distributions import t_sf
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import Finding, bonferroni, result_of, row_name, skipped
from tulip_testbed.identification.preflight.usual import Beyond, Usual, beyond
from tulip_testbed.identification.reading_noise import usable_sd
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import vertical_forces

UNWEIGHED = 10.0  # s.d. of the noise of a posture: that of a weight that nobody knows
NEGLIGIBLE = 1e-3  # of the weight; a smaller error is harmless without a stated cell_sd
CELL_ADVICE = (
    "Weigh a known mass over every cell, to find a gain (error grows with the load), a tare (constant "
    "error), a swapped, dead or saturated cell; check that nothing else touches robot or boards."
)


def weight_balance(measurements: Measurements, usual: Usual) -> Finding:
    """Compare the sum of the cells with the weighed mass: mean, scatter and single postures."""
    name, m = "weight balance", measurements
    if m.weighed_mass is None:
        return skipped(name, "no weighed_mass in the manifest; see 'constant weight' instead")
    mass, mass_sd = m.weighed_mass
    total = m.cell_forces.sum(axis=1)
    error = total - mass * m.gravity
    sd = _total_sd(m)
    ordinary = float(np.hypot(m.gravity * mass_sd, np.linalg.norm(usual.total.mean(axis=0))))
    if sd is None:
        if len(m) < 3:
            return skipped(name, "no sensors.cell_sd in the manifest, and too few postures to estimate it")
        spread = float(np.hypot(total.std(ddof=1) / np.sqrt(len(m)), ordinary))
        excess = max(abs(float(error.mean())) - NEGLIGIBLE * mass * m.gravity, 0.0)
        p_value = float(2 * t_sf(excess / max(spread, 1e-12), len(m) - 1)) if excess else 1.0
        seen = f"mean {error.mean():+.2f} N off {mass * m.gravity:.2f} N, s.e. {spread:.2f} N"
        expected = "within the cells' own scatter (no sensors.cell_sd stated)"
        return Finding(name, result_of(p_value), seen, expected, "", CELL_ADVICE, p_value)
    spread = float(np.hypot(sd / np.sqrt(len(m)), ordinary))
    row = int(np.abs(total - total.mean()).argmax())
    tested = _beyond(error, sd, usual, m.gravity * mass_sd)
    return Finding(
        name,
        tested.result,
        f"mean {error.mean():+.2f} N off {mass * m.gravity:.2f} N; scatter {_scatter(total):.2f} N"
        + tested.words,
        f"mean 0, s.e. {spread:.2f} N; scatter {_usual_scatter(sd, usual):.2f} N by cell_sd and tolerances",
        f"worst: {row_name(m, row)}, {error[row]:+.1f} N",
        CELL_ADVICE,
        tested.p_value,
    )


def constant_weight(measurements: Measurements, usual: Usual) -> Finding:
    """Check, without a weighed mass, that the total force is the same in all postures."""
    name, m = "constant weight", measurements
    if m.weighed_mass is not None:
        return skipped(name, "included in 'weight balance'")
    sd = _total_sd(m)
    if sd is None or len(m) < 2:
        return skipped(name, "needs weighed_mass or sensors.cell_sd in the manifest, and two postures")
    total = m.cell_forces.sum(axis=1)
    deviation = total - total.mean()
    row = int(np.abs(deviation).argmax())
    tested = _beyond(deviation, sd, usual, UNWEIGHED * sd)
    return Finding(
        name,
        tested.result,
        f"scatter {_scatter(total):.2f} N about {total.mean():.2f} N" + tested.words,
        f"{_usual_scatter(sd, usual):.2f} N by cell_sd and tolerances",
        f"worst: {row_name(m, row)}, {deviation[row]:+.1f} N",
        CELL_ADVICE,
        tested.p_value,
    )


def drift(measurements: Measurements, nominal: Nominal, usual: Usual) -> Finding:
    """Test for a trend over the experiment in quantities that should not change.

    These are the total force and the level of the swing sole. The test uses their own scatter (Student's t),
    so that no data sheet is needed, and the trend that ordinary imperfections have.
    """
    name, m = "drift", measurements
    timed = bool(np.isfinite(m.time).all())
    clock = m.time if timed else np.arange(len(m), dtype=float)
    if len(m) < 5 or np.ptp(clock) == 0:
        return skipped(name, "needs five postures at different times")
    total = m.cell_forces.sum(axis=1) if m.contacts is None else vertical_forces(m).sum(axis=1)
    harmless = NEGLIGIBLE * abs(float(total.mean()))
    channels = {"total force": (clock, total, usual.total, harmless, "N")}
    both = m.support == "double"  # a lifted foot is level at no time
    if m.contacts is not None and both.sum() >= 5:  # the zeros of one sensor and of two are not the same
        channels["total force"] = (clock[both], total[both], usual.total[both], harmless, "N")
    if both.sum() >= 5 and np.ptp(clock[both]) > 0:
        level = 1e3 * nominal.swing_sole(m.joint_angles[both])[:, 3:5]
        for k, name_of in enumerate(("roll", "pitch")):
            ordinary = 1e3 * usual.closure[both, 1 + k]
            channels[f"swing sole's {name_of}"] = (clock[both], level[:, k], ordinary, 1.0, "mrad")
    p_values, texts = [], []
    for label, (times, values, ordinary, harmless, unit) in channels.items():
        change, error, p_value = _change(times, values, ordinary, harmless)
        p_values.append(p_value)
        texts.append(f"{label} {change:+.2f} {unit}, s.e. {error:.2f}")
    p_value = bonferroni(np.array(p_values))
    hours = np.ptp(clock) / 3600
    length = f"{hours:.1f} h" if hours >= 1 else f"{60 * hours:.1f} min"
    length = length if timed else "the experiment (row order; no times given)"
    return Finding(
        name,
        result_of(p_value),
        f"over {length}: {'; '.join(texts)}",
        "no change beyond its standard error",
        list(channels)[int(np.argmin(p_values))],
        "Let cells and amplifiers warm up, tare between placements, check the encoders' zeros at the end.",
        p_value,
    )


def _total_sd(measurements: Measurements) -> float | None:
    cell_sd = usable_sd(measurements.sensors.cell_sd)
    return None if cell_sd is None else cell_sd * np.sqrt(measurements.cell_forces.shape[1])


def _beyond(error: np.ndarray, sd: float, usual: Usual, weight_sd: float) -> Beyond:
    """Test deviations of the total, (m,) [N], with a weight known to an s.d. of `weight_sd` [N]."""
    constant = np.ones((len(error), 1))
    changes = np.column_stack([usual.total, weight_sd * constant]) / sd
    names, ones = (*usual.names, "the weighed mass"), np.ones(len(error), int)
    return beyond(error[:, None] / sd, ones, changes[:, None], names, (constant / sd)[:, None])


def _scatter(total: np.ndarray) -> float:
    """Return the s.d. about the mean."""
    return float(total.std(ddof=1)) if len(total) > 1 else 0.0


def _usual_scatter(sd: float, usual: Usual) -> float:
    """Return the s.d. about the mean that noise and ordinary imperfections give."""
    return float(np.sqrt(sd**2 + usual.total.var(axis=0).sum()))


def _change(
    clock: np.ndarray, values: np.ndarray, ordinary: np.ndarray, harmless: float
) -> tuple[float, float, float]:
    """Return the change over the whole time by a line, its standard error, and its p-value.

    The null hypothesis is a change of at most `harmless`, and those by ordinary imperfections, of which one
    tolerance changes the values by (m, k).
    """
    span = np.ptp(clock)
    unit = (clock - clock.mean()) / span
    slope = float(unit @ values / (unit @ unit))
    rest = values - values.mean() - slope * unit
    by_noise = np.sqrt(rest @ rest / (len(values) - 2) / (unit @ unit))
    error = float(np.hypot(by_noise, np.linalg.norm(unit @ ordinary / (unit @ unit))))
    beyond = max(abs(slope) - harmless, 0.0)
    if beyond == 0:
        return slope, error, 1.0
    return slope, error, float(2 * t_sf(beyond / error, len(values) - 2)) if error else 0.0
