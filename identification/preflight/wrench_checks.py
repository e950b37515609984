"""Preflight of wrench sensors: vertical forces that carry the robot, horizontal ones that cancel."""

import numpy as np

from tulip_testbed.identification.contact_readings import noise_of_wrenches
from tulip_testbed.identification.conventions.audit_conventions import audit_conventions, can_be_audited
from tulip_testbed.identification.conventions.log_conventions import WrenchConvention
from tulip_testbed.identification.inertial_wrench import link_wrenches
from tulip_testbed.identification.kinematics import link_rotations, turned_about
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import Finding, row_name, skipped
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.contacts import WRENCH, Contacts
from tulip_testbed.measurements.data import vertical_forces

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
    forces = m.wrenches[..., :3]
    if contacts.mount == "ground":
        turns = [turned_about(np.array([0.0, 0.0, yaw])) for yaw in m.plate_poses[..., 2].ravel()]
        return np.einsum("mpab,mpb->mpa", np.reshape(turns, (len(m), 2, 3, 3)), forces)
    parameters = nominal.parameters
    rotations = link_rotations(parameters.tree, parameters.base, m.joint_angles)
    feet = np.stack([rotations[:, parameters.base], rotations[:, nominal.swing_frame]], axis=1)
    poses = np.array([turned_about(pose[3:]) for pose in contacts.pose])
    return np.einsum("mpab,pbc,mpc->mpa", feet, poses, forces)


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
