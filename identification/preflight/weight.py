"""Preflight: forces that carry the weight, the same in all postures, and horizontal ones that cancel."""

import numpy as np

from tulip_testbed.identification.contact_readings import noise_of_wrenches
from tulip_testbed.identification.conventions.audit_conventions import audit_conventions, can_be_audited
from tulip_testbed.identification.conventions.log_conventions import (
    WrenchConvention,
    contact_frames,
    in_base,
)
from tulip_testbed.identification.distributions import t_sf
from tulip_testbed.identification.inertial_wrench import link_wrenches
from tulip_testbed.identification.kinematics import turned_about
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import Finding, bonferroni, result_of, row_name, skipped
from tulip_testbed.identification.preflight.usual import Beyond, Usual, beyond
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.contacts import WRENCH, Contacts
from tulip_testbed.measurements.data import vertical_forces

UNWEIGHED = 10.0  # s.d. of the noise of a posture: that of a weight that nobody knows
NEGLIGIBLE = 1e-3  # of the weight; a smaller error is harmless without a stated cell_sd
CELL_ADVICE = (
    "Weigh a known mass over every cell, to find a gain (error grows with the load), a tare (constant "
    "error), a swapped, dead or saturated cell; check that nothing else touches robot or boards."
)
HORIZONTAL = "horizontal forces"
CARRIED = "carried weight"
DEVIATIONS = 4.0  # s.d. of the stated noise and zeros
UNSTATED_SHARE = 0.02  # of the weight, where neither is known
CHANGED_SHARE = 0.05  # of the weight, about a constant: soft feet lean by a degree or two
MODEL_SHARE = 0.1  # of the weight: between a robot that nobody weighed and its model
# What acts at the height of the sensor moves the centre of pressure by height times force over weight.
MOST_SHIFT = 0.005  # m
ADVICE = (
    "Level feet at rest push each other with equal and opposite forces. Check the sensors' zeros (lift the "
    "robot), their pose in the feet (tilt, yaw), signs, and that nothing else touches the robot."
)
CONVENTIONS = "conventions"


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
    p_value = bonferroni(p_values)
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
    cell_sd = measurements.sensors.cell_sd
    return cell_sd * np.sqrt(measurements.cell_forces.shape[1]) if cell_sd else None


def _beyond(error: np.ndarray, sd: float, usual: Usual, weight_sd: float) -> Beyond:
    """Test deviations of the total, (m,) [N], with a weight known to an s.d. of `weight_sd` [N]."""
    constant = np.ones((len(error), 1))
    changes = np.column_stack([usual.total, weight_sd * constant]) / sd
    names, ones = (*usual.names, "the weighed mass"), np.ones(len(error), int)
    return beyond(error[:, None] / sd, ones, changes[:, None], names, (constant / sd)[:, None])


def _scatter(total: np.ndarray) -> float:
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


def carried_weight(measurements: Measurements, nominal: Nominal) -> Finding:
    """Compare the sum of the vertical forces with the weighed mass, or else with the model's."""
    m, contacts = measurements, measurements.contacts
    assert contacts is not None
    total = vertical_forces(m).sum(axis=1) + contacts.below[:, 0].sum() * m.gravity
    weighed = m.weighed_mass is not None
    mass, mass_sd = m.weighed_mass or (nominal.mass, MODEL_SHARE / DEVIATIONS * nominal.mass)
    noise, zero = _force_sd(contacts, "fz")
    if np.isinf(zero):
        return skipped(CARRIED, "the zeros of the vertical forces are unknown")
    known = zero > 0 or noise > 0
    share = 0.0 if known else UNSTATED_SHARE * mass * m.gravity
    sd = float(np.hypot(zero, mass_sd * m.gravity))
    limit = DEVIATIONS * sd + share + DEVIATIONS * noise / np.sqrt(len(m))
    error = float(total.mean() - mass * m.gravity)
    row = int(np.abs(total - total.mean()).argmax())
    result = "pass" if abs(error) <= limit else "warn" if abs(error) < 2 * limit else "fail"
    return Finding(
        CARRIED,
        result,
        f"mean {error:+.1f} N ({100 * error / mass / m.gravity:+.1f} %) off {mass * m.gravity:.1f} N of the "
        f"{'weighed mass' if weighed else 'model'}; from {total.min():.1f} to {total.max():.1f} N",
        f"within {limit:.1f} N by "
        + ("zeros and noise" if known else f"{100 * UNSTATED_SHARE:.0f} % of the weight")
        + ("" if weighed else f", and {100 * MODEL_SHARE:.0f} % between robot and model"),
        f"furthest from the mean: {row_name(m, row)}, {total[row] - total.mean():+.1f} N",
        "Check units, signs and zeros of the vertical forces, and weigh the robot.",
    )


def horizontal_forces(measurements: Measurements, nominal: Nominal) -> Finding:
    """Check that horizontal forces cancel in double support, or stay the same with unknown zeros."""
    m, contacts = measurements, measurements.contacts
    assert contacts is not None
    both = m.support == "double"
    if contacts.channels != WRENCH:
        return skipped(HORIZONTAL, "the sensors give vertical forces and their moments only")
    if not both.any():
        return skipped(HORIZONTAL, "no posture stands on both feet")
    noise = max(_force_sd(contacts, axis)[0] for axis in ("fx", "fy"))
    zero = max(_force_sd(contacts, axis)[1] for axis in ("fx", "fy"))
    rows, changes = np.flatnonzero(both), bool(np.isinf(zero))
    total = _in_base(m, contacts, nominal)[rows].sum(axis=1)[:, :2]
    if m.joint_accelerations is not None:
        total = total - link_wrenches(nominal, m.take(rows))[0].sum(axis=1)[:, :2]
    weight = float(vertical_forces(m)[rows].sum(axis=1).mean())
    known = (noise > 0 or zero > 0) and not changes
    share = CHANGED_SHARE if changes else UNSTATED_SHARE
    total = total - np.median(total, axis=0) if changes else total
    limit = DEVIATIONS * float(np.hypot(noise, zero)) if known else share * weight
    size = np.linalg.norm(total, axis=1)
    worst = int(size.argmax())
    lever = 0.0 if contacts.mount == "ground" else np.abs(contacts.pose[:, 2] - nominal.points[:, 2]).max()
    shift = float(lever) * size[worst] / weight
    result = "pass" if size[worst] <= limit else "fail" if shift > MOST_SHIFT else "warn"
    low, high = total.min(axis=0), total.max(axis=0)
    constant = "a constant and " if changes else ""
    seen = (
        f"the feet's horizontal forces sum to {constant}{low[0]:+.1f} to {high[0]:+.1f} N in x, "
        f"{low[1]:+.1f} to {high[1]:+.1f} N in y, up to {100 * size[worst] / weight:.0f} % of the weight"
    )
    if result != "pass":
        seen += "; they do not cancel"
    return Finding(
        HORIZONTAL,
        result,
        f"{seen}. At the sensors' height they move the centre of pressure by {1e3 * shift:.1f} mm",
        f"sums below {limit:.1f} N, "
        + ("by the stated noise and zeros" if known else f"{100 * share:.0f} % of the weight"),
        row_name(m, int(rows[worst])),
        ADVICE,
    )


def _force_sd(contacts: Contacts, axis: str) -> tuple[float, float]:
    """Return the s.d. of a force's sum over both feet by noise, 0 if unknown, and by the zeros [N]."""
    k = contacts.channels.index(axis)
    stated = contacts.covariance is not None
    noise = float(np.sqrt(2 * noise_of_wrenches(contacts)[k, k])) if stated else 0.0
    return noise, float(np.linalg.norm(contacts.zero_sd[:, k]))


def _in_base(m: Measurements, contacts: Contacts, nominal: Nominal) -> np.ndarray:
    """Return the forces on both feet in the base frame, (m, 2, 3) [N]."""
    assert m.wrenches is not None
    if contacts.mount == "ground":
        turns = [turned_about(np.array([0.0, 0.0, yaw])) for yaw in m.plate_poses[..., 2].ravel()]
        return np.einsum("mpab,mpb->mpa", np.reshape(turns, (len(m), 2, 3, 3)), m.wrenches[..., :3])
    return in_base(m.wrenches, contact_frames(nominal, m), WrenchConvention())[..., :3]


def conventions(measurements: Measurements, nominal: Nominal) -> Finding:
    """Compare the wrenches with those that the robot needs, in every convention that logs are written in."""
    if not can_be_audited(measurements):
        return skipped(CONVENTIONS, "needs six-axis sensors in the feet and some rows of them")
    found = audit_conventions(measurements, nominal)
    force, moment = 100 * found.residual[:3].max(), 1e3 * found.residual[3:].max()
    taken = [f"{row.what}: {row.hypothesis}" for row in found.rows if row.applied]
    taken += [found.doubt] if found.doubt else []
    log = [f"{one.what}: {one.hypothesis}" for one in measurements.conventions if one.applied]
    converted = [one for one in log if one not in taken]
    changed = found.convention != WrenchConvention()
    seen = (
        f"likeliest are {', '.join(taken)}; not explained are {force:.1f} % of the weight and {moment:.1f} mm"
    )
    if found.problems and not changed:
        seen = "; ".join(found.problems)
    if converted:
        seen += f"; the folder holds wrenches as the contract has them, the log had {', '.join(converted)}"
    return Finding(
        CONVENTIONS,
        "fail" if changed else "warn" if found.problems else "pass",
        seen,
        "wrenches of the ground on the robot in the sensor's axes, and joints as in the robot's file",
        advice="Import the log with `import`, which reads it in the likeliest convention, or correct `map`.",
    )
