"""Preflight: closure of the legs, and feet that stay in place."""

import numpy as np

from tulip_testbed.identification.distributions import normal_sf
from tulip_testbed.identification.nominal import Nominal, jacobian
from tulip_testbed.identification.preflight.finding import Finding, bonferroni, result_of, row_name, skipped
from tulip_testbed.identification.preflight.usual import Usual, beyond
from tulip_testbed.identification.reading_noise import usable_sd
from tulip_testbed.measurements import Measurements

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
NO_ENCODER_SD = "the manifest states no sensors.encoder_sd"


def legs(measurements: Measurements, nominal: Nominal, usual: Usual) -> list[Finding]:
    """Run both checks of the legs."""
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
    encoder_sd = usable_sd(m.sensors.encoder_sd)
    if encoder_sd is None:
        return skipped(name, NO_ENCODER_SD)
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
