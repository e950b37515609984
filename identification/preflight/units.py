"""Preflight: the right robot, SI units, and joint limits."""

from collections.abc import Iterator

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import Finding, few, row_name
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.measurements.data import vertical_forces

# Allowed beyond a limit: drives sag under gravity by up to 0.02 rad in the simulated laboratory.
LIMIT_WARN, LIMIT_FAIL = 0.03, 0.1  # rad
MOST_CELL, MOST_POSE = 2.0, 3.0  # m: a cell from its plate's middle, a plate from the stance foot
LEAST_CELLS = 2e-3  # m: twice the r.m.s. distance of a plate's cells from one line
MOST_YAW = np.pi / 2
MOST_ENCODER_SD = 0.1  # rad
MOST_PLACEMENT_SD = 0.2  # m
MOST_CELL_SD = 0.2  # of the weight
Complaints = Iterator[tuple[str, str]]  # place and words


def same_robot(measurements: Measurements, nominal: Nominal) -> Finding:
    """Compare model file, feet and joint order with the nominal robot."""
    name, robot, wrong = "robot", nominal.robot, []
    seen = f"{robot.model_file.name}, as in the manifest"
    found, file_hash = measurements.robot, robot.model_hash
    if found["sha256"] is None and found["model"] != robot.model_file.name:
        wrong.append(f"model '{found['model']}'")
    elif found["sha256"] is None:
        seen += "; compared by name only, since no sha256 is given"
    elif found["sha256"].lower() != file_hash:
        wrong.append(f"sha256 {found['sha256'][:12]}... of {found['model']}")
    for key, expected in (("stance_foot", robot.stance_foot), ("swing_foot", robot.swing_foot)):
        if found[key] != expected:
            wrong.append(f"{key} '{found[key]}'")
    joints = nominal.parameters.tree.joints
    if measurements.joints != joints:
        wrong.append(f"joints {', '.join(measurements.joints)}")
    feet = f"{robot.stance_foot} and {robot.swing_foot}"
    expected = f"{robot.model_file.name} with sha256 {file_hash[:12]}..., on {feet}"
    if measurements.joints != joints:
        expected += f", joints {', '.join(joints)}"
    if wrong:
        advice = "Give the robot that was measured as `robot`, or correct the manifest."
        return Finding(name, "fail", "; ".join(wrong), expected, "manifest.json", advice)
    return Finding(name, "pass", seen, expected)


def units(measurements: Measurements, nominal: Nominal) -> Finding:
    """Detect degrees instead of radians, millimetres instead of metres, kilograms instead of newtons."""
    complaints = [*_angles(measurements, nominal), *_lengths(measurements), *_masses(measurements, nominal)]
    expected = "rad, m, N, kg, s"
    if not complaints:
        return Finding("units", "pass", "angles, lengths, forces and mass of plausible size", expected)
    where = ", ".join(dict.fromkeys(place for place, _ in complaints))
    advice = "Convert these and check again; all other checks depend on the units."
    seen = "; ".join(few([text for _, text in complaints]))
    return Finding("units", "fail", seen, expected, where, advice)


def joint_limits(measurements: Measurements, nominal: Nominal) -> Finding:
    """Compare the joint angles with the model's ranges."""
    tree = nominal.parameters.tree
    angles = measurements.joint_angles
    beyond = np.maximum(tree.joint_range[:, 0] - angles, angles - tree.joint_range[:, 1])
    row, joint = np.unravel_index(beyond.argmax(), beyond.shape)
    worst = float(beyond[row, joint])
    expected = f"within the model's ranges, to {LIMIT_WARN} rad"
    if worst <= LIMIT_WARN:
        return Finding("joint limits", "pass", f"closest to a limit: {tree.joints[joint]}", expected)
    low, high = tree.joint_range[joint]
    count = int((beyond > LIMIT_WARN).any(axis=1).sum())
    return Finding(
        "joint limits",
        "fail" if worst > LIMIT_FAIL else "warn",
        f"q.{tree.joints[joint]} = {angles[row, joint]:.4f} rad, range [{low:.4f}, {high:.4f}]; {count} rows",
        expected,
        row_name(measurements, int(row)),
        "Look for an encoder's zero or sign, or a swapped column; otherwise correct the model's range.",
    )


def _angles(measurements: Measurements, nominal: Nominal) -> Complaints:
    tree = nominal.parameters.tree
    for k, joint in enumerate(tree.joints):
        angles, (low, high) = measurements.joint_angles[:, k], tree.joint_range[k]
        most = np.abs(angles).max()
        # A wrong sign or zero leaves the range by less, which 'joint limits' reports.
        if most > min(2 * max(abs(low), abs(high)), 2 * np.pi) and np.deg2rad(most) <= np.pi:
            read = f"{number(angles.min(), '.4g')} to {number(angles.max(), '.4g')}"
            text = f"q.{joint} reads {read} where [{low:.2f}, {high:.2f}] rad"
            yield f"q.{joint}", f"{text} is possible: degrees?"
    for plate, yaw in zip(PLATES, np.abs(measurements.plate_poses[:, :, 2]).max(axis=0), strict=True):
        read = f"reads up to {number(yaw, '.4g')}"
        yield from _too_large(f"plate.{plate}.yaw", yaw, MOST_YAW, read, "degrees")
    stated = measurements.sensors.encoder_sd or 0.0
    yield from _too_large("sensors.encoder_sd", stated, MOST_ENCODER_SD, f"is {stated:g}", "degrees")


def _lengths(measurements: Measurements) -> Complaints:
    m, unit = measurements, "millimetres"
    for p, plate in enumerate(PLATES if m.contacts is None else ()):
        place, spread = f"plates.{plate}.cells", m.cells[p] - m.cells[p].mean(axis=0)
        if np.linalg.svd(spread, compute_uv=False)[1] < LEAST_CELLS:
            yield place, f"{place} lie on one line, expected the corners of a board"
        for corner, far in zip(CORNERS, np.abs(m.cells[p]).max(axis=1), strict=True):
            read = f"lies {far:g} from the plate's middle"
            yield from _too_large(f"{place}.{corner}", far, MOST_CELL, read, unit)
    for p, plate in enumerate(PLATES):
        for axis, far in zip("xy", np.abs(m.plate_poses[:, p, :2]).max(axis=0), strict=True):
            yield from _too_large(f"plate.{plate}.{axis}", far, MOST_POSE, f"reads up to {far:g}", unit)
    height, stated = np.abs(m.top_height).max(), m.sensors.known_placement_sd[:2]
    yield from _too_large("plates.top_height", height, MOST_CELL, f"is {height:g}", unit)
    yield from _too_large("sensors.placement_sd", max(stated), MOST_PLACEMENT_SD, f"is {stated}", unit)


def _too_large(place: str, value: float, most: float, read: str, unit: str) -> Complaints:
    """Complain of a value above the largest plausible one, of another unit perhaps."""
    if value > most:
        yield place, f"{place} {read}: {unit}?"


def _masses(measurements: Measurements, nominal: Nominal) -> Complaints:
    mass, gravity = nominal.mass, measurements.gravity
    if measurements.weighed_mass is not None:
        weighed = measurements.weighed_mass[0]
        if not 0.5 < weighed / mass < 2:
            guess = _guess(weighed / mass, {gravity: "newtons", 1000.0: "grams"})
            text = f"'weighed_mass' is {weighed:g} where the model weighs {number(mass, '.4g')} kg{guess}"
            yield "weighed_mass", text
        else:
            mass = weighed
    contacts = measurements.contacts
    if contacts is not None and (below := float(contacts.below[:, 0].sum())) >= mass:
        text = f"{below:g} kg below the contact sensors where the whole robot weighs {number(mass, '.4g')} kg"
        yield "contacts.below", text
    if contacts is not None and np.isinf(contacts.zero_sd[:, contacts.channels.index("fz")]).any():
        return
    total = float(np.median(vertical_forces(measurements).sum(axis=1)))
    stated = measurements.sensors.cell_sd
    if stated is not None and stated > MOST_CELL_SD * mass * gravity:
        text = f"sensors.cell_sd is {stated:g} where {number(mass, '.4g')} kg stand on eight cells: grams?"
        yield "sensors.cell_sd", text
    if not 0.5 < total / (mass * gravity) < 2:
        guess = _guess(total / (mass * gravity), {1 / gravity: "kilograms", 1000 / gravity: "grams"})
        what, place = ("the cells", "cell.*") if contacts is None else ("vertical forces", "wrench.*.fz")
        text = f"{what} sum to {number(total, '.4g')} where {number(mass, '.4g')} kg "
        text += f"weigh {number(mass * gravity, '.4g')} N{guess}"
        yield place, text


def _guess(ratio: float, factors: dict[float, str]) -> str:
    for factor, unit in factors.items():
        if 0.5 < ratio / factor < 2:
            return f": {unit}?"
    return ""
