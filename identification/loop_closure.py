"""Estimate the encoders' errors from the closed chain of two standing feet.

While both soles are flat in a placement, the height and the tilt of the swing foot by the measured angles
vary between postures only by the encoders' errors. This gives the standard deviation of these errors without
a data sheet and without masses. The foot's x, y and yaw hold more information, but a foot may have slipped
or been put down again.
"""

import numpy as np

from tulip_testbed.identification import kinematics
from tulip_testbed.identification.kinematics import Tree

LEAST_FREEDOM = 20  # degrees of freedom from which the variance is preferred to the data sheet's
SINGULAR = 1e-9  # of the largest eigenvalue


def encoder_sd_by_closure(
    tree: Tree, base: int, swing: int, joint_angles: np.ndarray, placement: np.ndarray
) -> float | None:
    """Estimate the s.d. of the encoders' errors that vary between postures [rad].

    The swing foot's height and tilt are r = K (delta + b) + c, where K is their Jacobian, delta are
    independent errors of one variance, b constant encoder offsets and c the floor of a placement.
    Generalised least squares eliminates b and c; the residual gives the variance.

    Args:
        tree: kinematics.
        base, swing: frame numbers of the stance and the swing foot.
        joint_angles: (m, n_joints) [rad].
        placement: number of each posture's placement, (m,).

    Returns:
        The s.d., or None if there are too few postures.
    """
    if not len(placement):
        return None
    pose, slope = _swing_sole(tree, base, swing, joint_angles)
    weight, rank = _inverse(slope @ slope.mT)
    whole = np.concatenate([slope, pose[..., None]], axis=2)
    _, group = np.unique(placement, return_inverse=True)
    normal, moment = np.zeros((group.max() + 1, 3, 3)), np.zeros((group.max() + 1, 3, whole.shape[2]))
    np.add.at(normal, group, weight)
    np.add.at(moment, group, weight @ whole)
    inverse, floors = _inverse(normal)
    rest = whole - (inverse @ moment)[group]
    gram = np.tensordot(rest, weight @ rest, axes=((0, 1), (0, 1)))
    inverse_gram, offsets = _inverse(gram[:-1, :-1])
    freedom = rank - floors - offsets
    if freedom < LEAST_FREEDOM:
        return None
    residual = gram[-1, -1] - gram[-1, :-1] @ inverse_gram @ gram[:-1, -1]
    return float(np.sqrt(max(residual, 0.0) / freedom))


def _inverse(matrices: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the pseudoinverses of positive semidefinite matrices (..., k, k) and the sum of their ranks."""
    values, turn = np.linalg.eigh(matrices)
    nonzero = values > SINGULAR * values.max(initial=1e-300)
    inverse = np.where(nonzero, 1 / np.where(nonzero, values, 1.0), 0.0)
    return (turn * inverse[..., None, :]) @ turn.mT, int(nonzero.sum())


def _swing_sole(tree: Tree, base: int, swing: int, joint_angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the swing foot's height and normal (x, y), (m, 3) [m, -, -], and the Jacobian, (m, 3, n)."""
    rotations = kinematics.link_rotations(tree, base, joint_angles)
    positions = kinematics.frame_positions(tree, base, rotations, np.zeros(3))
    axes = kinematics.joint_axes(tree, base, rotations) * kinematics.moved_frames(tree, base)[:, swing, None]
    pivots = kinematics.joint_pivots(tree, base, rotations, positions)
    place, normal = positions[:, swing], rotations[:, swing, :, 2]
    rise = np.cross(axes, place[:, None] - pivots)[..., 2:]
    tilt = np.cross(axes, normal[:, None])[..., :2]
    return np.column_stack([place[:, 2], normal[:, :2]]), np.concatenate([rise, tilt], axis=2).mT
