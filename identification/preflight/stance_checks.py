"""Preflight: plate poses, feet on their plates and in place, loads inside the soles, closed legs."""

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.identification.center_of_pressure import cell_positions
from tulip_testbed.identification.distributions import normal_isf, normal_sf
from tulip_testbed.identification.feasibility import foot_clearance
from tulip_testbed.identification.nominal import Nominal, jacobian
from tulip_testbed.identification.observation import turned
from tulip_testbed.identification.preflight.finding import (
    Finding,
    bonferroni,
    few,
    result_of,
    row_name,
    skipped,
)
from tulip_testbed.identification.preflight.usual import Usual, beyond
from tulip_testbed.identification.reading_noise import placement_levers, placement_sd
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES

SAME_POSE = 1e-9  # m, rad: largest difference of the recorded poses of a placement
BOARD_EDGE = 0.05  # m, largest overhang of a board beyond its cells
GROSSLY_BEYOND = 0.2  # m, of a sole: by a wrong sign or another plate, no effect of the catalogue
GROSS_SHARE = 0.3  # of the loads outside their soles: two swapped cells make 0.14
LEAST_LOAD = 0.05  # of the weight; with less load a plate's own centre of pressure is not used
# The feet push against each other. This cancels in the sum, but shifts each plate's own centre of pressure by
# the height of the top times horizontal over vertical force; which was at most 0.09 in 395 holds.
MOST_PUSH = 0.2
POSE_ADVICE = (
    "Measure the plates' poses again: base frame at the stance ankle, x forward, y left, "
    "yaw counter-clockwise."
)
CLOSED = [2, 3, 4]  # of x, y, z, roll, pitch, yaw: fixed by both soles flat on level tops
PLANAR = [0, 1, 5]
# A robot that is put down again stands within a millimetre of its marks (simulated laboratory), which does
# not affect the centre of pressure; a foot that moves by more has slipped.
STAY = np.array([0.005, 0.005, 0.02])  # m, m, rad
GROSS = np.array([50.0, 150.0, 150.0])  # mm, mrad: by a wrong sign or joint, no effect of the catalogue
LEVEL = 0.05  # rad: soles that are level but for encoders, zeros and yielding
LEG = 0.5  # m: length by which a sole's height counts as an angle
CLEARLY = 2.0  # times worse or better, from which a turned sign is told
EXPLAINED = 0.8  # share of the chi-square from which a joint is named


def plate_poses(measurements: Measurements) -> Finding:
    """Check for one pose per placement, the left plate on the left, and plates apart."""
    name, m = "plate poses", measurements
    expected = "one pose per plate and placement, left plate on the left, plates apart"
    corners, placements = cell_positions(m).reshape(-1, 2, 4, 2), np.unique(m.placement)
    changes, failures = {}, {}  # by placement
    for placement in placements:
        rows, here = np.flatnonzero(m.placement == placement), f"placement {placement}"
        spread = np.ptp(m.plate_poses[rows], axis=0)
        if spread.max() > SAME_POSE:
            plate, axis = np.unravel_index(spread.argmax(), spread.shape)
            column = f"plate.{PLATES[plate]}.{('x', 'y', 'yaw')[axis]}"
            changes[here] = f"{column} changes by {number(spread[plate, axis], '.4g')} within {here}"
        right, left = corners[rows[0]].mean(axis=1)
        if left[1] <= right[1]:
            failures[here] = f"{here}: left plate at y {left[1]:.3f}, right at {right[1]:.3f} m"
        elif foot_clearance(*corners[rows[0]]) == 0:
            failures[here] = f"{here}: the plates' cells overlap"
    faulty = changes | failures
    if not faulty:
        return Finding(name, "pass", f"{len(placements)} placements, as expected", expected)
    return Finding(
        name,
        "fail" if failures else "warn",
        "; ".join(few([*failures.values(), *changes.values()])),
        expected,
        ", ".join(few([one for one in map("placement {}".format, placements) if one in faulty])),
        POSE_ADVICE + " A plate that was moved begins a new placement.",
    )


def feet_on_plates(measurements: Measurements, nominal: Nominal) -> Finding:
    """Check that the soles, by the measured angles, are over the rectangle of their plate's cells."""
    name, m = "feet on plates", measurements
    expected = f"each sole over its own plate, at most {1e3 * BOARD_EDGE:.0f} mm beyond the cells"
    soles = nominal.soles_in_base(m.joint_angles)
    beyond = np.stack([_beyond(m, soles[:, foot], plate=foot) for foot in (0, 1)], axis=1)
    crossed = np.stack([_beyond(m, soles[:, foot], plate=1 - foot) for foot in (0, 1)], axis=1)
    middle = np.stack([_beyond(m, soles[:, f].mean(axis=1, keepdims=True), f) for f in (0, 1)], axis=1)
    row, foot = np.unravel_index(beyond.argmax(), beyond.shape)
    worst = float(beyond[row, foot])
    feet = nominal.robot.feet
    if worst <= BOARD_EDGE:
        seen = f"at most {1e3 * max(worst, 0):.0f} mm of a sole beyond the cells"
        return Finding(name, "pass", seen, expected)
    seen = f"{feet[foot]} reaches {1e3 * worst:.0f} mm beyond the cells of the {PLATES[foot]} plate"
    advice = POSE_ADVICE
    if np.median(crossed) < 0 < np.median(beyond):
        seen += "; both feet stand on each other's plate"
        advice = "Swap right and left: the right plate is the one under the stance foot. " + POSE_ADVICE
    return Finding(
        name,
        "fail" if (middle > 0).any() else "warn",
        f"{seen}; {int((beyond > BOARD_EDGE).any(axis=1).sum())} rows",
        expected,
        row_name(m, int(row)),
        advice,
        gross=bool((middle > 0).any()) and worst > GROSSLY_BEYOND,
    )


def load_in_soles(measurements: Measurements, nominal: Nominal) -> Finding:
    """Check that each plate's centre of pressure is inside the sole that stands on it."""
    name, m = "load inside soles", measurements
    cell_sd = m.sensors.cell_sd
    if not cell_sd:
        return skipped(name, "the manifest states no sensors.cell_sd")
    soles = nominal.soles_in_base(m.joint_angles)
    forces = m.cell_forces.reshape(-1, 2, 4)
    load = forces.sum(axis=2)
    enough = load > LEAST_LOAD * load.sum(axis=1, keepdims=True)
    if not enough.any():
        return skipped(name, "no plate carries a load")
    positions = cell_positions(m).reshape(-1, 2, 4, 2)
    divisor = np.where(enough, load, np.nan)[:, :, None]
    cop = np.einsum("mpc,mpca->mpa", forces, positions) / divisor
    lever = (positions - cop[:, :, None]) / divisor[..., None]
    spread = cell_sd**2 * np.einsum("mpca,mpcb->mpab", lever, lever) + _pose_spread(m)
    outside, sd = _outside(cop, soles, spread)
    z = np.where(enough, (outside - MOST_PUSH * np.abs(m.top_height)) / sd, -np.inf)
    row, foot = np.unravel_index(z.argmax(), z.shape)
    p_value = bonferroni(normal_sf(z[enough]))
    count = int((z > normal_isf(0.01 / z.size)).sum())
    return Finding(
        name,
        result_of(p_value),
        f"{count} of {int(enough.sum())} plate CoPs beyond their sole's edge by more than noise",
        f"each plate's CoP inside its sole, but for {1e3 * MOST_PUSH * np.abs(m.top_height).max():.0f} mm "
        "(feet that push apart)",
        f"worst: {nominal.robot.feet[foot]}, {row_name(m, int(row))}, "
        f"{1e3 * outside[row, foot]:+.0f} mm from the edge, s.d. {1e3 * sd[row, foot]:.0f} mm",
        "Look for swapped cells of that plate, its pose's sign or origin, a wrong cell position.",
        p_value,
        gross=count > GROSS_SHARE * enough.sum(),
    )


def _beyond(m: Measurements, points: np.ndarray, plate: int) -> np.ndarray:
    """Return the largest distance of points (m, k, 2) beyond a plate's cells, (m,) [m]."""
    poses = m.plate_poses[:, plate, None]
    inside = turned(-poses[..., 2], points - poses[..., :2])
    low, high = m.cells[plate].min(axis=0), m.cells[plate].max(axis=0)
    return np.maximum(low - inside, inside - high).max(axis=(1, 2))


def _pose_spread(m: Measurements) -> np.ndarray:
    """Return the covariance of each plate's centre of pressure by its recorded pose, (m, 2, 2, 2) [m2]."""
    share = m.cell_forces.reshape(-1, 2, 4).sum(axis=2) / m.cell_forces.sum(axis=1)[:, None]
    levers = (placement_levers(m) * placement_sd(m)).reshape(-1, 2, 2, 3).transpose(0, 2, 1, 3)
    own = levers / np.where(np.abs(share) > LEAST_LOAD, share, 1.0)[:, :, None, None]
    return own @ own.transpose(0, 1, 3, 2)


def _outside(cop: np.ndarray, soles: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distance and s.d. of points (m, 2, 2) outside of convex polygons (m, 2, 4, 2), (m, 2) [m]."""
    edges = np.roll(soles, -1, axis=2) - soles
    normals = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    centre = soles.mean(axis=2, keepdims=True)
    normals *= np.sign(np.einsum("mpka,mpka->mpk", soles - centre, normals))[..., None]
    distance = np.einsum("mpka,mpka->mpk", cop[:, :, None] - soles, normals)
    edge = distance.argmax(axis=2)[..., None]
    sd = np.sqrt(np.einsum("mpka,mpab,mpkb->mpk", normals, spread, normals))
    return np.take_along_axis(distance, edge, 2)[..., 0], np.take_along_axis(sd, edge, 2)[..., 0]


def legs(measurements: Measurements, nominal: Nominal, usual: Usual) -> list[Finding]:
    pose = nominal.swing_sole(measurements.joint_angles)
    slope = jacobian(nominal.swing_sole, measurements.joint_angles)
    closed = _legs_close(measurements, nominal, pose, slope, usual)
    return [closed, _feet_stay(measurements, pose, slope)]


def misclosures(m: Measurements, nominal: Nominal) -> tuple[float, np.ndarray]:
    """Return by how much the soles miss being level at one height, r.m.s. over the postures [rad].

    It is returned as measured, and with the sign of one joint turned, (n_joints,).
    """
    signs = np.vstack([np.ones(len(m.joints)), 1.0 - 2 * np.eye(len(m.joints))])
    error = [nominal.swing_sole(m.joint_angles * turned)[:, 2:5] for turned in signs]
    error -= np.array([m.top_height[1] - m.top_height[0], 0.0, 0.0])
    open_by = np.sqrt(((error / [LEG, 1, 1]) ** 2).sum(axis=2).mean(axis=1))
    return float(open_by[0]), open_by[1:]


def _legs_close(
    measurements: Measurements, nominal: Nominal, pose: np.ndarray, slope: np.ndarray, usual: Usual
) -> Finding:
    """Compare the swing sole's height, roll and pitch by forward kinematics with what is usual."""
    name, m = "legs close", measurements
    encoder_sd = m.sensors.encoder_sd
    if not encoder_sd:
        return skipped(name, "the manifest states no sensors.encoder_sd")
    error = pose[:, CLOSED] - [m.top_height[1] - m.top_height[0], 0.0, 0.0]
    slope = slope[:, CLOSED]
    whitener, rank = _whitener(encoder_sd**2 * slope @ slope.mT + usual.unseen @ usual.unseen.mT)
    if rank.min() == 0:
        return skipped(name, "this robot's joints cannot tilt its swing foot")
    white = (whitener @ error[..., None])[..., 0]
    squares = (white**2).sum(axis=1)
    row = int(squares.argmax())
    tested = beyond(white, rank, whitener @ usual.closure, usual.names)
    rms = 1e3 * np.sqrt((error**2).mean(axis=0))
    parts = (encoder_sd * slope, usual.closure, usual.unseen)
    variance = np.sum([(part**2).sum(axis=2) for part in parts], axis=0)
    expected = 1e3 * np.sqrt(variance.mean(axis=0))
    advice = "Check the encoders' zeros and signs, link lengths, and that both soles lay flat."
    joint, offset, share = _one_offset(whitener @ slope, white)
    open_by, turned = misclosures(m, nominal) if tested.result == "fail" else (0.0, np.zeros(1))
    if open_by > LEVEL and turned.min() < open_by / CLEARLY:
        advice = (
            f"The sign of {m.joints[turned.argmin()]}: with it turned the soles would be level within "
            f"{turned.min():.2g} rad, they are within {open_by:.2g} rad. {advice}"
        )
    elif share > EXPLAINED:
        advice = (
            f"An offset of {1e3 * offset:+.1f} mrad at {m.joints[joint]} explains {100 * share:.0f} % of it. "
            f"{advice}"
        )
    return Finding(
        name,
        tested.result,
        f"swing sole's height {rms[0]:.2f} mm, roll {rms[1]:.2f}, pitch {rms[2]:.2f} mrad r.m.s."
        + tested.words,
        f"{expected[0]:.2f} mm, {expected[1]:.2f}, {expected[2]:.2f} mrad by encoder_sd and tolerances",
        f"worst: {row_name(m, row)}",
        advice,
        tested.p_value,
        gross=tested.result == "fail" and bool((rms > GROSS).any()),
    )


def _feet_stay(measurements: Measurements, pose: np.ndarray, slope: np.ndarray) -> Finding:
    """Check that the swing foot stays within a few millimetres in all postures of a placement."""
    name, m = "feet stay", measurements
    pose, slope = pose[:, PLANAR], slope[:, PLANAR]
    encoder_sd = m.sensors.encoder_sd or 0.0
    sd = encoder_sd * np.sqrt((slope**2).sum(axis=2))
    away = np.zeros_like(pose)
    for placement in np.unique(m.placement):
        rows = m.placement == placement
        away[rows] = pose[rows] - np.median(pose[rows], axis=0)
    beyond = np.maximum(np.abs(away) - STAY, 0.0)
    # The factor sqrt 2 accounts for the noise of the median.
    z = np.divide(beyond, np.sqrt(2) * sd, out=np.where(beyond > 0, np.inf, 0.0), where=sd > 0)
    p_values = np.where(beyond > 0, 2 * normal_sf(z), 1.0)
    p_value = bonferroni(p_values)
    row = int(p_values.min(axis=1).argmin()) if p_value < 1 else int((np.abs(away) / STAY).max(1).argmax())
    x, y, yaw = 1e3 * away[row]
    return Finding(
        name,
        result_of(p_value),
        f"furthest from its placement's median: ({x:+.1f}, {y:+.1f}) mm, {yaw:+.1f} mrad",
        "within ({:.0f}, {:.0f}) mm, {:.0f} mrad, but for encoder noise".format(*(1e3 * STAY)),
        row_name(m, row),
        "A foot slipped or was set down elsewhere: measure the plates again and number a new placement.",
        p_value,
    )


def _whitener(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return W with W V W' = 1 on the range of each V, (m, k, k), and its rank, (m,)."""
    values, vectors = np.linalg.eigh(covariance)
    usable = values > 1e-9 * values.max(axis=1, keepdims=True)
    scale = np.where(usable, 1 / np.sqrt(np.where(usable, values, 1.0)), 0.0)
    return scale[:, :, None] * vectors.transpose(0, 2, 1), usable.sum(axis=1)


def _one_offset(slope: np.ndarray, white: np.ndarray) -> tuple[int, float, float]:
    """Find the joint whose constant offset explains most: joint, offset [rad], share of the chi-square."""
    power = (slope**2).sum(axis=(0, 1))
    along = np.einsum("mkn,mk->n", slope, white)
    offsets = np.divide(along, power, out=np.zeros_like(along), where=power > 0)
    gained = offsets * along
    joint = int(gained.argmax())
    return joint, float(offsets[joint]), float(gained[joint] / max((white**2).sum(), 1e-300))
