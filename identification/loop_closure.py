"""How exact the joint encoders are, from the two feet: standing on both closes a chain.

While the feet of a placement stand still, the pose of the swing foot by the measured angles may
change from posture to posture by the encoders' errors alone. That gives a standard deviation of
their errors without any data sheet and without any mass.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from identification.kinematics import Tree, frame_positions, joint_axes, link_rotations, moved_frames, walk

LEAST_FREEDOM = 20  # degrees of freedom that make a variance worth more than a data sheet's
SINGULAR = 1e-9  # of the largest eigenvalue


def encoder_sd_by_closure(
    tree: Tree, base: int, swing: int, joint_angles: np.ndarray, placement: np.ndarray
) -> float | None:
    """S.d. of the encoders' errors that vary between postures [rad].

    With K the swing foot's Jacobian, r = K (delta + b) + c: delta independent errors of one
    variance, b constant offsets of the encoders, c the unknown pose of the foot in its placement.
    Generalised least squares takes out b and c and leaves the variance.

    Args:
        base, swing: frame numbers of the stance and the swing foot.
        joint_angles: (m, n_joints) [rad].
        placement: (m,).

    Returns:
        None where the postures do not suffice.
    """
    pose, slope = _swing_pose(tree, base, swing, joint_angles, placement)
    variance, turn = np.linalg.eigh(slope @ slope.transpose(0, 2, 1))
    seen = variance > SINGULAR * variance.max(initial=1e-300)
    weight = (turn * np.where(seen, 1 / np.where(seen, variance, 1.0), 0.0)[:, None]) @ turn.transpose(0, 2, 1)
    whole = np.concatenate([slope, pose[..., None]], axis=2)
    _, group = np.unique(placement, return_inverse=True)
    count = group.max() + 1
    normal, moment = np.zeros((count, 6, 6)), np.zeros((count, 6, whole.shape[2]))
    np.add.at(normal, group, weight)
    np.add.at(moment, group, weight @ whole)
    inverse = np.linalg.pinv(normal, hermitian=True, rtol=SINGULAR)
    rest = whole - (inverse @ moment)[group]
    gram = np.einsum("mai,mab,mbj->ij", rest, weight, rest, optimize=True)
    offsets, right = gram[:-1, :-1], gram[:-1, -1]
    known = int(np.linalg.matrix_rank(offsets, hermitian=True, rtol=SINGULAR))
    freedom = int(seen.sum()) - int(np.linalg.matrix_rank(normal, hermitian=True, rtol=SINGULAR).sum()) - known
    if freedom < LEAST_FREEDOM:
        return None
    left_over = gram[-1, -1] - right @ np.linalg.pinv(offsets, hermitian=True, rtol=SINGULAR) @ right
    return float(np.sqrt(max(left_over, 0.0) / freedom))


def _swing_pose(
    tree: Tree, base: int, swing: int, joint_angles: np.ndarray, placement: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Swing foot against its placement's first posture, (m, 6) [m, rad], and its Jacobian, (m, 6, n)."""
    rotations = link_rotations(tree, base, joint_angles)
    positions = frame_positions(tree, base, rotations, np.zeros(3))
    axes = joint_axes(tree, base, rotations) * moved_frames(tree, base)[:, swing, None]
    pivots = np.zeros_like(axes)
    for step in walk(tree, base):
        if step.edge.joint >= 0:
            pivots[:, step.edge.joint] = positions[:, step.new] + rotations[:, step.new] @ step.anchor_new
    arms = np.cross(axes, positions[:, None, swing] - pivots)
    slope = np.concatenate([arms, axes], axis=2).transpose(0, 2, 1)
    _, first, group = np.unique(placement, return_index=True, return_inverse=True)
    reference = first[group]
    foot = rotations[:, swing]
    turned = Rotation.from_matrix(foot @ foot[reference].transpose(0, 2, 1)).as_rotvec()
    return np.hstack([positions[:, swing] - positions[reference, swing], turned]), slope
