"""Where the nominal robot stands: links and soles in the base frame of each posture's support."""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.kinematics import frame_positions, link_rotations
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.measurements.data import base_foot


def link_frames(
    nominal: Nominal, joint_angles: np.ndarray, support: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return all frames in the base frame, (m, n_frames, 3, 3) and (m, n_frames, 3) [m].

    Args:
        joint_angles: (m, n_joints) [rad]. support: "double", "right" or "left", (m,).
    """
    tree, count = nominal.parameters.tree, len(joint_angles)
    rotations, positions = np.empty((count, len(tree.frames), 3, 3)), np.empty((count, len(tree.frames), 3))
    bases, foot = (nominal.parameters.base, nominal.swing_frame), base_foot(support)
    for k, (base, point) in enumerate(zip(bases, nominal.points, strict=True)):
        rows = foot == k
        turned = link_rotations(tree, base, joint_angles[rows])
        rotations[rows], positions[rows] = turned, frame_positions(tree, base, turned, -point)
    return rotations, positions


def soles_in_base(nominal: Nominal, joint_angles: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Return the corners of the right and the left sole from above, in the base frame, (m, 2, 4, 2) [m]."""
    rotations, positions = link_frames(nominal, joint_angles, support)
    soles = []
    bases = (nominal.parameters.base, nominal.swing_frame)
    for base, corners, point in zip(bases, nominal.soles, nominal.points, strict=True):
        local = np.column_stack([corners, np.full(len(corners), point[2])])
        placed = positions[:, base, None] + local @ rotations[:, base].transpose(0, 2, 1)
        soles.append(placed[..., :2])
    return np.stack(soles, axis=1)
