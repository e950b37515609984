"""Residuals of an experiment in four channels, and their derivatives.

A: centre of pressure minus the regressor's prediction (x, y). F: sum of the cell forces minus the weight.
T: twist of the right and the left plate, f1 - f2 + f3 - f4; six-axis sensors in the feet, which have no
twist, have the direction of the force there, horizontal over vertical, against the vertical seen
from the kinematics (x, y). With it the tilt of a foot cancels. C: closure of the legs: height, roll and pitch
of the swing foot from the joint angles, and its x, y and yaw, which are constant in a placement.
"""

import itertools
import math

import numpy as np

from tulip_testbed.identification.kinematics import roll_pitch_yaw
from tulip_testbed.identification.observation import CLOSURE, SIZE, TWISTS, Observation, turned
from tulip_testbed.measurements.data import feet_in_contact

CHANNELS = ("A", "F", "T", "C")
ROWS = {"A": slice(0, 2), "F": slice(2, 3), "T": TWISTS, "C": CLOSURE}
FROM_POSE = [2, 3, 4, 0, 1, 5]  # of x, y, z, roll, pitch, yaw: what channel C holds
ANCHORED = slice(8, 11)  # x, y, yaw of the swing foot, known up to a constant of the placement
UNITS = {"A": "mm", "F": "N", "T": "N", "C": "mm, deg"}
TWIST = np.array([1.0, -1.0, 1.0, -1.0])
# Fields of an observation that may vary between postures, by short names in the order of `packed`.
PARTS = {
    "angles": "joint_angles",
    "cells": "cell_forces",
    "plates": "plate_poses",
    "stance_tilt": "stance_tilt",
    "swing_tilt": "swing_tilt",
    "rise": "swing_rise",
    "shift": "shift",
    "lift": "lift",
    "push": "push",
}
VARYING = tuple(PARTS.values())


def packed(observed: Observation) -> np.ndarray:
    """Return all fields that may vary between postures side by side, (m, n_joints + 2 k + 16).

    The order is joint angles, readings of cells or wrench sensors, plate poses, stance tilt, swing tilt,
    rise, shift, lift, push.
    """
    m = len(observed)
    return np.concatenate([getattr(observed, name).reshape(m, -1) for name in VARYING], axis=1)


def fields(observed: Observation) -> dict[str, slice]:
    """Return the columns of `packed` by name."""
    widths = [math.prod(getattr(observed, name).shape[1:]) for name in VARYING]
    ends = [0, *itertools.accumulate(widths)]
    return {part: slice(*both) for part, both in zip(PARTS, itertools.pairwise(ends), strict=True)}


def unpacked(observed: Observation, values: np.ndarray) -> Observation:
    """Return the observation with the fields of `packed` replaced (the inverse of `packed`)."""
    at = fields(observed)
    return observed.changed(
        **{n: values[:, at[part]].reshape(getattr(observed, n).shape) for part, n in PARTS.items()}
    )


def moved_by(observed: Observation, before: Observation, after: Observation) -> Observation:
    """Return an observation changed by the difference of two others, with the lengths of the second.

    The assumed lengths and cell positions become those of `after`. A field that `before` and
    `after` share stays the same array.
    """
    change = {
        name: getattr(observed, name) + (getattr(after, name) - getattr(before, name))
        for name in VARYING
        if getattr(after, name) is not getattr(before, name)
    }
    return observed.changed(tree=after.tree, cells=after.cells, **change)


def difference(before: Observation, after: Observation) -> np.ndarray:
    """Return the difference of two observations' fields side by side, as in `packed`."""
    at = fields(before)
    out = np.zeros((len(before), at["push"].stop))
    for part, name in PARTS.items():
        first, second = getattr(before, name), getattr(after, name)
        if second is not first:
            out[:, at[part]] = (second - first).reshape(len(first), -1)
    return out


def residuals(observed: Observation, theta: np.ndarray) -> np.ndarray:
    """Compute the residuals of all channels, (m, 11) [m, m, N, N, N, m, rad, rad, m, m, rad].

    Those of the direction, in channel T, are in rad. The base parameters theta are (p,) [m].
    """
    out = np.empty((len(observed), SIZE))
    out[:, ROWS["A"]] = center(observed) - observed.geometry.regressor @ theta
    down = carried(observed) @ observed.contacts.bears.ravel()
    out[:, ROWS["F"]] = (down - observed.weight - observed.lift)[:, None]
    if has_twist(observed):
        out[:, ROWS["T"]] = observed.cell_forces.reshape(-1, 2, 4) @ TWIST
    else:
        out[:, ROWS["T"]] = _off_vertical(observed) if has_direction(observed) else 0.0
    pose = swing_pose(observed)
    out[:, 5] = pose[:, 2] - observed.swing_rise
    out[:, 6:8] = pose[:, 3:5] - observed.swing_tilt
    out[:, ANCHORED] = pose[:, [0, 1, 5]]
    if observed.moves:
        out[:, ROWS["C"]] += observed.motion.between[:, FROM_POSE]
        out += in_motion(observed, observed.motion.slope) @ (theta - observed.nominal.value)
    return out


def by_base_parameters(observed: Observation) -> np.ndarray:
    """Differentiate the residuals by the base parameters, (m, 11, p)."""
    regressor = observed.geometry.regressor
    out = np.zeros((len(observed), SIZE, regressor.shape[2]))
    out[:, ROWS["A"]] = -regressor
    return out + in_motion(observed, observed.motion.slope) if observed.moves else out


def in_motion(observed: Observation, change: np.ndarray) -> np.ndarray:
    """Return the change of the residuals by that of what motion adds, (m, 5, k) -> (m, 11, k)."""
    out = np.zeros((len(observed), SIZE, change.shape[2]))
    out[:, ROWS["A"]] = -change[:, :2]
    out[:, ROWS["F"]] = -change[:, 2:3]
    if has_direction(observed):
        out[:, ROWS["T"]] = -change[:, 3:]
    return out


def carried(observed: Observation) -> np.ndarray:
    """Return the readings of the contacts, zero under a foot in the air, (m, 2 k)."""
    return np.where(
        _each_reading(observed, feet_in_contact(observed.measurements.support)), observed.cell_forces, 0.0
    )


def has_twist(observed: Observation) -> bool:
    """Return whether the contacts are plates on four cells each, which alone have a twist."""
    return observed.contacts.by_channel is None


def has_direction(observed: Observation) -> bool:
    """Return whether the contacts are six-axis sensors in the feet, which measure the force's direction."""
    return observed.in_feet and observed.contacts.pushes is not None


def _off_vertical(observed: Observation) -> np.ndarray:
    """Compute the direction of the force against the vertical as the feet's tilt shows it, (m, 2) [rad]."""
    tilts = np.concatenate([observed.stance_tilt, observed.swing_tilt], axis=1)
    return _direction(observed) - observed.push - (_leaning(observed) * tilts[:, None]).sum(axis=2)


def _direction(observed: Observation) -> np.ndarray:
    """Return the measured direction of the force against the vertical of flat soles, (m, 2) [rad]."""
    return (_pushes(observed) * carried(observed)[:, None]).sum(axis=2) / total_force(observed)[:, None]


def _pushes(observed: Observation) -> np.ndarray:
    """Return the horizontal force in the base frame by a unit of each reading, (m, 2, 2 k)."""
    pushes = observed.contacts.pushes
    assert pushes is not None
    yaw = observed.contact_poses[..., 2]
    turn = turned(yaw[:, :, None], np.broadcast_to(pushes.mT, (len(observed), *pushes.mT.shape)))
    return turn.reshape(len(observed), -1, 2).mT


def _across(observed: Observation) -> np.ndarray:
    """Differentiate the horizontal force by the yaw of both sensors, (m, 2, 2) [N]."""
    each = _pushes(observed) * carried(observed)[:, None]
    x, y = each.reshape(len(observed), 2, 2, -1).sum(axis=3).transpose(1, 0, 2)
    return np.stack([-y, x], axis=1)


def _leaning(observed: Observation) -> np.ndarray:
    """Differentiate the vertical's direction in the base frame by roll and pitch of both feet, (m, 2, 4).

    A foot that rolls sees the vertical lean to its left, one that pitches to its rear. Each counts by its
    load.
    """
    down = (carried(observed).reshape(len(observed), 2, -1) * observed.contacts.bears).sum(axis=2)
    share, yaw = down / down.sum(axis=1, keepdims=True), observed.contact_poses[..., 2]
    each = [turned(yaw, np.broadcast_to(way, (*yaw.shape, 2))) for way in ((0.0, 1.0), (-1.0, 0.0))]
    return (np.stack(each, axis=2) * share[..., None, None]).reshape(len(observed), 4, 2).mT


def _each_reading(observed: Observation, of_feet: np.ndarray) -> np.ndarray:
    """Repeat what holds for each foot, (m, 2), for each of its readings, (m, 2 k)."""
    return np.repeat(of_feet, observed.cell_forces.shape[1] // 2, axis=1)


def residuals_in_use(observed: Observation) -> np.ndarray:
    """Return which residuals of each posture hold information, (m, 11) bool."""
    contact = feet_in_contact(observed.measurements.support)
    used = np.ones((len(observed), SIZE), bool)
    used[:, ROWS["C"]] = np.all(contact, axis=1, keepdims=True)
    used[:, ROWS["T"]] = contact & observed.on_four_cells if has_twist(observed) else has_direction(observed)
    return used


def constants_of_stances(used: np.ndarray) -> np.ndarray:
    """Return the columns of the swing foot's x, y and yaw, (m, 11, 3), where `residuals_in_use` has them."""
    anchored = range(ANCHORED.start, ANCHORED.stop)
    out = np.zeros((*used.shape, len(anchored)))
    out[:, anchored, np.arange(len(anchored))] = used[:, ANCHORED]
    return out


def center(observed: Observation) -> np.ndarray:
    """Compute the centre of pressure (eq. 11) of the weight on flat soles, (m, 2) [m].

    It is seen from the stance foot's sole point, also where that foot is in the air: there the known lengths
    give its place. The shift by other forces is subtracted. A tilted foot that carries rotates the robot
    about its sole point, which moves the centre of mass in proportion to its height; the nominal height is
    accurate enough. Known masses are taken off.
    """
    whole, rows = _measured(observed) - observed.shift, observed.geometry.on_swing_foot
    if rows.any():
        whole[rows] -= observed.geometry.stance_sole[rows, :2]
    tilt = np.where(rows[:, None], observed.swing_tilt, observed.stance_tilt)  # of the foot that carries
    if tilt.any():
        roll, pitch = tilt.T
        whole = whole - observed.loaded_center[:, 2:] * np.column_stack([pitch, -roll])
    return whole if observed.ballast is None else observed.ballast.without(whole)


def _measured(observed: Observation) -> np.ndarray:
    """Compute the centre of pressure by the contacts in the base frame, (m, 2) [m]."""
    return (carried(observed)[..., None] * observed.cell_places).sum(axis=1) / total_force(observed)[:, None]


def total_force(observed: Observation) -> np.ndarray:
    """Return the vertical force of all contacts, (m,) [N]; that of wrench sensors by the weight.

    Their zeros may be large and unknown. Over the weight the centre of pressure is linear in them, with
    columns that hold no noise of the forces.
    """
    if has_twist(observed):
        return carried(observed) @ observed.contacts.bears.ravel()
    return observed.weight + observed.lift


def more_as_read(clean: Observation, by_cells: np.ndarray) -> np.ndarray:
    """Return how much more the noise of cells moved the centre of pressure as it was read, (m, 2, 2 k).

    It is a moment over the force. Where effects took off a part of the force or moved the cells outwards, the
    noise would count as a larger one, and where they added to it or moved them inwards as a smaller one: both
    would count as evidence. Other sensors: zero, because theirs is over the weight.

    Args:
        by_cells: the derivative of the centre of pressure by the forces as they are now, (m, 2, 2 k) [m/N].
    """
    if not has_twist(clean):
        return np.zeros_like(by_cells)
    m, force = clean.measurements, total_force(clean)[:, None, None]
    over = force / total_force(clean.changed(cell_forces=m.cell_forces))[:, None, None]
    moved = turned(clean.contact_poses[:, :, None, 2], (m.cells - clean.cells)[None])
    moved = moved.reshape(len(clean), -1, 2).swapaxes(1, 2)
    return over * (by_cells + (by_cells != 0) * moved / force) - by_cells


def by_weight(observed: Observation) -> np.ndarray:
    """Differentiate channels A, F and T by the weight, with which inertial forces grow, (m, 5)."""
    by_lift = _by_lift(observed)
    if not (observed.moves and observed.motion.shown):
        return by_lift
    return by_lift * (1 + observed.motion.by_cad[:, 2:3] / observed.weight)


def _by_lift(observed: Observation) -> np.ndarray:
    """Differentiate channels A, F and T by the vertical force, (m, 5) [m/N, -, 1/N]."""
    out = np.zeros((len(observed), ROWS["T"].stop))
    out[:, 2] = -1.0
    if not has_twist(observed):
        out[:, :2] = -_measured(observed) / total_force(observed)[:, None]
    if has_direction(observed):
        out[:, ROWS["T"]] = -_direction(observed) / total_force(observed)[:, None]
    return out


def swing_pose(observed: Observation) -> np.ndarray:
    """Compute the swing sole's pose over the ground: x, y, z, roll, pitch, yaw, (m, 6) [m, rad]."""
    place, foot = observed.swing_sole
    if observed.stance_tilt.any():
        tilt = np.concatenate([observed.stance_tilt, np.zeros((len(observed), 1))], axis=1)
        place = place + np.cross(tilt, place)
        foot = foot + np.cross(tilt[:, None], foot.mT).mT
    return np.column_stack([place, roll_pitch_yaw(foot)])


def sensitivity(observed: Observation, theta: np.ndarray) -> np.ndarray:
    """Differentiate the residuals at theta, (p,) [m], by `packed`, (m, 11, n_joints + 2 k + 16)."""
    at, m = fields(observed), len(observed)
    out = np.zeros((m, SIZE, at["push"].stop))
    forces, bears = carried(observed), observed.contacts.bears
    total, contact = (
        total_force(observed),
        _each_reading(observed, feet_in_contact(observed.measurements.support)),
    )
    lever = observed.cell_places
    if has_twist(observed):
        lever = lever - bears.reshape(-1, 1) * _measured(observed)[:, None]
    out[:, 0:2, at["cells"]] = (lever / total[:, None, None] * contact[..., None]).transpose(0, 2, 1)
    out[:, 2, at["cells"]] = contact * bears.ravel()
    if has_twist(observed):
        out[:, 3, at["cells"].start : at["cells"].start + 4] = TWIST
        out[:, 4, at["cells"].start + 4 : at["cells"].stop] = TWIST
    if has_direction(observed):
        out[:, ROWS["T"], at["cells"]] = _pushes(observed) * contact[:, None] / total[:, None, None]
        out[:, ROWS["T"], at["stance_tilt"].start : at["swing_tilt"].stop] = -_leaning(observed)
        out[:, ROWS["T"], at["push"]] = -np.eye(2)
        yaws = [at["plates"].start + 2, at["plates"].start + 5]
        out[:, ROWS["T"], yaws] = _across(observed) / total[:, None, None]
    by_pose = _by_contact_poses(observed, forces.reshape(m, 2, -1) / total[:, None, None])
    rates = _foot_rates(observed)
    out[:, 0:2, at["angles"]] = -observed.geometry.slope_along(theta)
    rows = observed.geometry.on_swing_foot
    if has_direction(observed):
        by_left = _across(observed)[:, :, 1:] / total[:, None, None]
        out[~rows, ROWS["T"], at["angles"]] = (by_left * rates[:, 5:])[~rows]
    if rows.any():
        out[rows, 0:2, at["angles"]] -= observed.geometry.stance_sole_slope[rows, :2]
    if observed.in_feet:
        # The left sensor moves with the swing foot; a foot that is the base does not move.
        out[~rows, 0:2, at["angles"]] += by_pose[~rows, :, 3:] @ rates[~rows, 3:]
        by_pose = _in_axes_of_feet(observed, by_pose)
    out[:, 0:2, at["plates"]] = by_pose
    out[:, 5:, at["angles"]] = rates
    height = observed.loaded_center[:, 2]
    place, turn = observed.swing_sole
    yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    roll, pitch = at["stance_tilt"].start, at["stance_tilt"].start + 1
    for tilt, seen in (("stance_tilt", ~rows), ("swing_tilt", rows)):
        out[seen, 0, at[tilt].start + 1], out[seen, 1, at[tilt].start] = -height[seen], height[seen]
    for axis, column in enumerate((roll, pitch)):
        spin = np.broadcast_to(np.eye(3)[axis], (m, 1, 3))
        out[:, 5:, column] = _in_channel(np.cross(spin, place[:, None]), spin, yaw)[..., 0]
    out[:, 6, at["swing_tilt"].start] = out[:, 7, at["swing_tilt"].start + 1] = -1.0
    out[:, 5, at["rise"].start] = -1.0
    out[:, 0, at["shift"].start] = out[:, 1, at["shift"].start + 1] = -1.0
    out[:, : ROWS["T"].stop, at["lift"].start] = _by_lift(observed)
    if (ballast := observed.ballast) is not None:
        plain = -observed.geometry.slope_along(theta)  # the regressor's: the masses are not in it
        out[:, 0:2] *= (1 + ballast.ratio)[:, None, None]
        out[:, 0:2, at["angles"]] -= ballast.ratio[:, None, None] * plain + ballast.slope
    return out


def _by_contact_poses(observed: Observation, share: np.ndarray) -> np.ndarray:
    """Differentiate the centre of pressure by x, y and yaw of both contacts in the base frame, (m, 2, 6)."""
    m, bears = len(observed), observed.contacts.bears
    poses = observed.contact_poses[:, :, None, :2]
    arms = observed.cell_places.reshape(m, 2, -1, 2) - bears[..., None] * poses
    moment = (share[..., None] * arms).sum(axis=2)
    out = np.zeros((m, 2, 6))
    for side in (0, 1):
        first = 3 * side
        out[:, 0, first] = out[:, 1, first + 1] = (share[:, side] * bears[side]).sum(axis=1)
        out[:, 0, first + 2], out[:, 1, first + 2] = -moment[:, side, 1], moment[:, side, 0]
    return out


def _in_axes_of_feet(observed: Observation, by_pose: np.ndarray) -> np.ndarray:
    """Return the derivative by displacements in the feet's own axes, (m, 2, 6)."""
    out = by_pose.copy()
    for side, yaw in enumerate((observed.contact_poses - observed.plate_poses)[..., 2].T):
        plane = slice(3 * side, 3 * side + 2)
        out[..., plane] = turned(-yaw[:, None], by_pose[..., plane])
    return out


def _foot_rates(observed: Observation) -> np.ndarray:
    """Differentiate channel C by the joint angles for nearly flat feet, (m, 6, n_joints)."""
    geometry = observed.geometry
    place, turn = geometry.swing_sole
    axes = geometry.axes * geometry.moved[:, observed.nominal.swing_frame, None]
    displacement = np.cross(axes, place[:, None] - geometry.pivots)
    return _in_channel(displacement, axes, np.arctan2(turn[:, 1, 0], turn[:, 0, 0]))


def _in_channel(displacement: np.ndarray, spin: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Return displacements and rotations of the swing foot, (m, k, 3) each, as channel C, (m, 6, k)."""
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    roll, pitch = c * spin[..., 0] + s * spin[..., 1], c * spin[..., 1] - s * spin[..., 0]
    return np.stack(
        [displacement[..., 2], roll, pitch, displacement[..., 0], displacement[..., 1], spin[..., 2]], axis=1
    )
