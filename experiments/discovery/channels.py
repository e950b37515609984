"""Residuals of an experiment in four channels, and what moves them.

A: centre of pressure minus the regressor's (x, y); F: sum of the cells minus the weight; T: twist of
the right and the left plate, f1 - f2 + f3 - f4; C: closure of the legs: height, roll and pitch of
the swing foot by the angles, and its x, y and yaw, which are constant in a placement.
"""

from __future__ import annotations

import numpy as np

from experiments.effects.nominal_loads import joint_pivots
from experiments.effects.seen import Seen
from identification.kinematics import frame_positions, joint_axes, link_rotations, moved_frames
from identification.nominal import Nominal

CHANNELS = ("A", "F", "T", "C")
ROWS = {"A": slice(0, 2), "F": slice(2, 3), "T": slice(3, 5), "C": slice(5, 11)}
SIZE = 11
ANCHORED = slice(8, 11)  # x, y, yaw of the swing foot: known up to a constant of the placement
UNITS = {"A": "mm", "F": "N", "T": "N", "C": "mm, deg"}
TWIST = np.array([1.0, -1.0, 1.0, -1.0])


def packed(seen: Seen) -> np.ndarray:
    """All that may vary by posture side by side, (m, n_joints + 22).

    Angles, cells, plates' poses, stance tilt, swing tilt, rise, shift, lift.
    """
    return np.concatenate(
        [
            seen.joint_angles,
            seen.cell_forces,
            seen.plate_poses.reshape(-1, 6),
            seen.stance_tilt,
            seen.swing_tilt,
            seen.swing_rise[:, None],
            seen.shift,
            seen.lift[:, None],
        ],
        axis=1,
    )


def fields(nominal: Nominal) -> dict[str, slice]:
    """Columns of `packed`."""
    n = len(nominal.parameters.tree.joints)
    return {
        "angles": slice(0, n),
        "cells": slice(n, n + 8),
        "plates": slice(n + 8, n + 14),
        "stance_tilt": slice(n + 14, n + 16),
        "swing_tilt": slice(n + 16, n + 18),
        "rise": slice(n + 18, n + 19),
        "shift": slice(n + 19, n + 21),
        "lift": slice(n + 21, n + 22),
    }


def unpacked(seen: Seen, values: np.ndarray) -> Seen:
    """The inverse of `packed`."""
    at = fields(seen.nominal)
    return seen.changed(
        joint_angles=values[:, at["angles"]],
        cell_forces=values[:, at["cells"]],
        plate_poses=values[:, at["plates"]].reshape(-1, 2, 3),
        stance_tilt=values[:, at["stance_tilt"]],
        swing_tilt=values[:, at["swing_tilt"]],
        swing_rise=values[:, at["rise"]][:, 0],
        shift=values[:, at["shift"]],
        lift=values[:, at["lift"]][:, 0],
    )


def residuals(seen: Seen, theta: np.ndarray) -> np.ndarray:
    """All channels, (m, 11) [m, m, N, N, N, m, rad, rad, m, m, rad].

    Args:
        theta: base parameters, (p,) [m].
    """
    out = np.empty((len(seen), SIZE))
    out[:, ROWS["A"]] = center(seen) - seen.nominal.parameters.regressor(seen.joint_angles) @ theta
    forces = carried(seen)
    out[:, ROWS["F"]] = (forces.sum(axis=1) - seen.weight - seen.lift)[:, None]
    out[:, ROWS["T"]] = seen.cell_forces.reshape(-1, 2, 4) @ TWIST
    pose = swing_pose(seen)
    out[:, 5] = pose[:, 2] - seen.swing_rise
    out[:, 6:8] = pose[:, 3:5] - seen.swing_tilt
    out[:, ANCHORED] = pose[:, [0, 1, 5]]
    return out


def carried(seen: Seen) -> np.ndarray:
    """What the cells under the feet bear, (m, 8) [N]."""
    return np.where(np.repeat(standing(seen), 4, axis=1), seen.cell_forces, 0.0)


def standing(seen: Seen) -> np.ndarray:
    """Whether the right and the left foot stand, (m, 2) bool."""
    support = seen.measurements.support
    return np.column_stack([support != "left", support != "right"])


def center(seen: Seen) -> np.ndarray:
    """Centre of pressure (eq. 11) less what is not the weight's on flat soles, (m, 2) [m].

    A tilted stance foot turns the robot about its sole point: the centre of mass moves by its height,
    for which the nominal one is good enough.
    """
    forces = carried(seen)
    measured = (forces[..., None] * seen.cell_places).sum(axis=1) / forces.sum(axis=1)[:, None]
    roll, pitch = seen.stance_tilt.T
    leaned = seen.center[:, 2:] * np.column_stack([pitch, -roll])
    return measured - seen.shift - leaned


def swing_pose(seen: Seen) -> np.ndarray:
    """Pose of the swing sole over the ground by the angles: x, y, z, roll, pitch, yaw, (m, 6) [m, rad]."""
    base = seen.nominal.parameters.base
    rotations = link_rotations(seen.tree, base, seen.joint_angles)
    positions = frame_positions(seen.tree, base, rotations, -seen.nominal.points[0])
    foot = rotations[:, seen.nominal.swing_frame]
    place = positions[:, seen.nominal.swing_frame] + foot @ seen.nominal.points[1]
    tilt = np.concatenate([seen.stance_tilt, np.zeros((len(seen), 1))], axis=1)
    place = place + np.cross(tilt, place)
    foot = foot + np.cross(tilt[:, None], foot.mT).mT
    roll = np.arctan2(foot[:, 2, 1], foot[:, 2, 2])
    pitch = -np.arcsin(np.clip(foot[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(foot[:, 1, 0], foot[:, 0, 0])
    return np.column_stack([place, roll, pitch, yaw])


def sensitivity(seen: Seen, theta: np.ndarray) -> np.ndarray:
    """Derivative of the residuals by the fields of `packed`, (m, 11, n_joints + 22).

    Args:
        theta: base parameters, (p,) [m].
    """
    at, m = fields(seen.nominal), len(seen)
    out = np.zeros((m, SIZE, at["lift"].stop))
    forces = carried(seen)
    total = forces.sum(axis=1)
    stands = np.repeat(standing(seen), 4, axis=1)
    measured = (forces[..., None] * seen.cell_places).sum(axis=1) / total[:, None]
    lever = (seen.cell_places - measured[:, None]) / total[:, None, None]
    out[:, 0:2, at["cells"]] = (lever * stands[..., None]).transpose(0, 2, 1)
    out[:, 2, at["cells"]] = stands
    out[:, 3, at["cells"].start : at["cells"].start + 4] = TWIST
    out[:, 4, at["cells"].start + 4 : at["cells"].stop] = TWIST
    plates = forces.reshape(-1, 2, 4)
    arms = seen.cell_places.reshape(-1, 2, 4, 2) - seen.plate_poses[:, :, None, :2]
    moment = (plates[..., None] * arms).sum(axis=2) / total[:, None, None]
    for side in (0, 1):
        first = at["plates"].start + 3 * side
        out[:, 0, first] = out[:, 1, first + 1] = plates[:, side].sum(axis=1) / total
        out[:, 0, first + 2], out[:, 1, first + 2] = -moment[:, side, 1], moment[:, side, 0]
    out[:, 0:2, at["angles"]] = -seen.nominal.parameters.slope(seen.joint_angles) @ theta
    out[:, 5:, at["angles"]] = _foot_rates(seen)
    height = seen.center[:, 2]
    place, turn = seen.swing_sole
    yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    roll, pitch = at["stance_tilt"].start, at["stance_tilt"].start + 1
    out[:, 0, pitch], out[:, 1, roll] = -height, height
    for axis, column in enumerate((roll, pitch)):
        spin = np.broadcast_to(np.eye(3)[axis], (m, 1, 3))
        out[:, 5:, column] = _in_channel(np.cross(spin, place[:, None]), spin, yaw)[..., 0]
    out[:, 6, at["swing_tilt"].start] = out[:, 7, at["swing_tilt"].start + 1] = -1.0
    out[:, 5, at["rise"].start] = -1.0
    out[:, 0, at["shift"].start] = out[:, 1, at["shift"].start + 1] = -1.0
    out[:, 2, at["lift"].start] = -1.0
    return out


def _foot_rates(seen: Seen) -> np.ndarray:
    """Derivative of channel C by the joint angles, (m, 6, n_joints): the feet are nearly flat."""
    base, nominal = seen.nominal.parameters.base, seen.nominal
    rotations, positions = seen.frames
    place, turn = seen.swing_sole
    axes = joint_axes(seen.tree, base, rotations)
    axes = axes * moved_frames(seen.tree, base)[:, nominal.swing_frame, None]
    way = np.cross(axes, place[:, None] - joint_pivots(seen.tree, base, rotations, positions))
    return _in_channel(way, axes, np.arctan2(turn[:, 1, 0], turn[:, 0, 0]))


def _in_channel(way: np.ndarray, spin: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Ways and turns of the swing foot as rows of channel C, (m, k, 3) twice -> (m, 6, k)."""
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    roll, pitch = c * spin[..., 0] + s * spin[..., 1], c * spin[..., 1] - s * spin[..., 0]
    return np.stack([way[..., 2], roll, pitch, way[..., 0], way[..., 1], spin[..., 2]], axis=1)
