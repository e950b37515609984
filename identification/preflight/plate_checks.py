"""Preflight: plate poses, feet on their plates, and loads inside the soles."""

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.identification.center_of_pressure import cell_positions
from tulip_testbed.identification.distributions import normal_isf, normal_sf
from tulip_testbed.identification.feasibility import foot_clearance
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import turned
from tulip_testbed.identification.preflight.finding import (
    Finding,
    bonferroni,
    few,
    result_of,
    row_name,
    skipped,
)
from tulip_testbed.identification.reading_noise import placement_levers, placement_sd, usable_sd
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


def plate_poses(measurements: Measurements) -> Finding:
    """Check for one pose per placement, the left plate on the left, and plates apart."""
    name, m = "plate poses", measurements
    expected = "one pose per plate and placement, left plate on the left, plates apart"
    warnings, failures, where = [], [], []
    corners = cell_positions(m).reshape(-1, 2, 4, 2)
    for placement in np.unique(m.placement):
        rows = np.flatnonzero(m.placement == placement)
        spread = np.ptp(m.plate_poses[rows], axis=0)
        if spread.max() > SAME_POSE:
            plate, axis = np.unravel_index(spread.argmax(), spread.shape)
            warnings.append(
                f"plate.{PLATES[plate]}.{('x', 'y', 'yaw')[axis]} changes by "
                f"{number(spread[plate, axis], '.4g')} within placement {placement}"
            )
            where.append(f"placement {placement}")
        right, left = corners[rows[0]].mean(axis=1)
        if left[1] <= right[1]:
            failures.append(
                f"placement {placement}: left plate at y {left[1]:.3f}, right at {right[1]:.3f} m"
            )
            where.append(f"placement {placement}")
        elif foot_clearance(*corners[rows[0]]) == 0:
            failures.append(f"placement {placement}: the plates' cells overlap")
            where.append(f"placement {placement}")
    if not (warnings or failures):
        count = len(np.unique(m.placement))
        return Finding(name, "pass", f"{count} placements, as expected", expected)
    return Finding(
        name,
        "fail" if failures else "warn",
        "; ".join(few([*failures, *warnings])),
        expected,
        ", ".join(few(list(dict.fromkeys(where)))),
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
    cell_sd = usable_sd(m.sensors.cell_sd)
    if cell_sd is None:
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
