"""How exact the joint encoders are, from the two feet: standing on both closes a chain.

While both soles lie flat in a placement, the height and the tilt of the swing foot by the measured
angles change from posture to posture by the encoders' errors alone. That gives a standard deviation
of their errors without any data sheet and without any mass. The foot's x, y and yaw would tell more,
but a foot may have slid or been put down anew.
"""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.kinematics import (
    Tree,
    frame_positions,
    joint_axes,
    link_rotations,
    moved_frames,
    walk,
)

LEAST_FREEDOM = 20  # degrees of freedom that make a variance worth more than a data sheet's
SINGULAR = 1e-9  # of the largest eigenvalue


def encoder_sd_by_closure(
    tree: Tree, base: int, swing: int, joint_angles: np.ndarray, placement: np.ndarray
) -> float | None:
    """S.d. of the encoders' errors that vary between postures [rad].

    With K the Jacobian of the swing foot's height and tilt r, r = K (delta + b) + c: delta independent
    errors of one variance, b constant offsets of the encoders, c the floor in a placement. Generalised
    least squares takes out b and c and leaves the variance.

    Args:
        base, swing: frame numbers of the stance and the swing foot.
        joint_angles: (m, n_joints) [rad].
        placement: (m,).

    Returns:
        None where the postures do not suffice.
    """
    if not len(placement):
        return None
    pose, slope = _swing_sole(tree, base, swing, joint_angles)
    weight, observed = _inverse(slope @ slope.mT)
    whole = np.concatenate([slope, pose[..., None]], axis=2)
    _, group = np.unique(placement, return_inverse=True)
    normal, moment = np.zeros((group.max() + 1, 3, 3)), np.zeros((group.max() + 1, 3, whole.shape[2]))
    np.add.at(normal, group, weight)
    np.add.at(moment, group, weight @ whole)
    inverse, floors = _inverse(normal)
    rest = whole - (inverse @ moment)[group]
    gram = np.tensordot(rest, weight @ rest, axes=((0, 1), (0, 1)))
    shown, offsets = _inverse(gram[:-1, :-1])
    freedom = observed - floors - offsets
    if freedom < LEAST_FREEDOM:
        return None
    left_over = gram[-1, -1] - gram[-1, :-1] @ shown @ gram[:-1, -1]
    return float(np.sqrt(max(left_over, 0.0) / freedom))


def _inverse(matrices: np.ndarray) -> tuple[np.ndarray, int]:
    """Pseudoinverses of positive semidefinite matrices (..., k, k), and the sum of their ranks."""
    values, turn = np.linalg.eigh(matrices)
    observed = values > SINGULAR * values.max(initial=1e-300)
    inverse = np.where(observed, 1 / np.where(observed, values, 1.0), 0.0)
    return (turn * inverse[..., None, :]) @ turn.mT, int(observed.sum())


def _swing_sole(tree: Tree, base: int, swing: int, joint_angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of the swing foot and its normal's x and y, (m, 3) [m, -, -], and their Jacobian, (m, 3, n)."""
    rotations = link_rotations(tree, base, joint_angles)
    positions = frame_positions(tree, base, rotations, np.zeros(3))
    axes = joint_axes(tree, base, rotations) * moved_frames(tree, base)[:, swing, None]
    pivots = np.zeros_like(axes)
    for step in walk(tree, base):
        if step.edge.joint >= 0:
            pivots[:, step.edge.joint] = positions[:, step.new] + rotations[:, step.new] @ step.anchor_new
    place, normal = positions[:, swing], rotations[:, swing, :, 2]
    rise = np.cross(axes, place[:, None] - pivots)[..., 2:]
    tilt = np.cross(axes, normal[:, None])[..., :2]
    return np.column_stack([place[:, 2], normal[:, :2]]), np.concatenate([rise, tilt], axis=2).mT
