"""Dry friction after the approach to a posture.

Friction at rest may take any value up to its limit, depending on how the posture was reached. It opposes
the last displacement of the joint: along the path, which ends as the third power of the remaining time
(minimum jerk), and in the sway of the robot as it stops. After a short displacement friction is below its
limit. After the robot is put down, sway is the only displacement. The sizes were fitted to a development
plan in full dynamics (docs/explanation/equilibrium.md) and give distributions, not the friction
of a single posture.
"""

import numpy as np

from tulip_testbed.sim.statics.forces import axial_vector
from tulip_testbed.sim.statics.solve import Reference

# Fitted to a development plan in full dynamics (seed 11); a test compares with the shipped plan.
SHORT_MOVE = (
    0.09  # rad, displacement after which friction is at 0.7 of its limit, for moves of REFERENCE_TIME
)
REFERENCE_TIME = 2.0  # s
SWAY = 0.6  # s.d. of the push along x and y whose static deflection equals the sway, in robot weights
SCATTER = 0.05  # s.d. of a joint's individual friction relative to its limit, after a move
PUT_DOWN_SCATTER = 0.35  # the same after the robot was put down


def approach_displacements(
    reference: Reference,
    planned: np.ndarray,
    columns: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    closed: np.ndarray,
) -> np.ndarray:
    """Return the final displacement of every coordinate on the path to a posture, (b, n) [rad].

    The torso arrives on a straight line. With both feet in contact, the derivative of the closure gives the
    rates of the joints between them; all other joints move on a line in joint space.

    Args:
        planned: planned joint angles of these postures, (k, n_joints) [rad].
        columns: coordinates that the joints' servos turn, (n_joints,).
        start, end: indices of the postures between which the robot moves, (b,).
        closed: whether both feet are in contact, (b,) bool.
    """
    n = reference.state.angles.shape[-1]
    displacement = planned[end] - planned[start]
    if closed.any():
        displacement[closed] = _closed_displacements(
            reference, displacement[closed], columns, start[closed], end[closed]
        )
    out = np.zeros((len(end), n))
    out[:, columns] = displacement
    return out


def _closed_displacements(
    reference: Reference, straight: np.ndarray, columns: np.ndarray, start: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Return the displacements with both feet in contact from those on a line, (b, n_joints) [rad]."""
    n = reference.state.angles.shape[-1]
    closure = reference.slope[end][:, 6 + n :]
    first, last = (reference.state.rotation[which] for which in (start, end))
    there = reference.state.position[end] - reference.state.position[start]
    step = np.concatenate([there, _rotation_vector(last @ first.transpose(0, 2, 1))], axis=-1)
    joints = closure[:, :, 6 : 6 + n][:, :, columns]
    between = np.abs(joints).max(axis=(0, 1)) > 0
    rates = -(np.linalg.pinv(joints[..., between]) @ (closure[..., :6] @ step[..., None]))[..., 0]
    displacement = straight.copy()
    displacement[:, between] = rates
    return displacement


def sway_displacements(
    reference: Reference, weight: float, which: np.ndarray, push: np.ndarray
) -> np.ndarray:
    """Return every coordinate's displacement, (b, n) [rad], by standard normal pushes at the torso."""
    n = reference.state.angles.shape[-1]
    yielding = -reference.inverse[:, 6 : 6 + n, :2]
    return SWAY * weight * (yielding[which] @ push[..., None])[..., 0]


def friction_at_rest(
    limit: np.ndarray, displacement: np.ndarray, moved: np.ndarray, move_time: float, scatter: np.ndarray
) -> np.ndarray:
    """Return the torques of dry friction at rest, (..., n) [Nm].

    Args:
        limit: dry friction of every coordinate, (n,) [Nm].
        displacement: final displacement of path and sway together, (..., n) [rad].
        moved: whether the robot moved to the posture; otherwise it was put down, (...,) bool.
        move_time: time of a move [s].
        scatter: standard normal, (..., n).
    """
    short = SHORT_MOVE * (move_time / REFERENCE_TIME) ** 3
    spread = np.where(moved, SCATTER, PUT_DOWN_SCATTER)[..., None]
    share = spread * scatter - displacement / np.sqrt(displacement**2 + short**2)
    return limit * np.clip(share, -1.0, 1.0)


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Return the rotation vectors of rotation matrices by less than half a turn, (..., 3) [rad]."""
    odd = axial_vector(rotation)
    sine = np.linalg.norm(odd, axis=-1, keepdims=True)
    cosine = (np.trace(rotation, axis1=-2, axis2=-1)[..., None] - 1) / 2
    return odd * np.arctan2(sine, cosine) / np.maximum(sine, 1e-12)
