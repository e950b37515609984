"""Dry friction as the approach to a posture leaves it.

Friction at rest may be anything up to its limit; which it is depends on how the posture was
reached. It stands against the joint's last way: along the path, which ends as the third power of
the time left (minimum jerk), and with the swaying of the robot as it stops. Where that way was
short, friction has not come to its limit. After putting down only the swaying is left. The sizes
come from a development plan in full dynamics (docs/equilibrium.md); they give distributions:
what a single posture's friction is, this does not know.
"""

from __future__ import annotations

import numpy as np

from tulip_testbed.sim.statics.forces import axial_vector
from tulip_testbed.sim.statics.solve import Reference

# Fitted to a development plan in full dynamics (seed 11); held against the shipped one by a test.
SHORT_WAY = 0.09  # rad, at which 0.7 of the friction is left, for moves of REFERENCE_TIME
REFERENCE_TIME = 2.0  # s
SWAY = 0.6  # s.d. of the push along x and y whose static deflection is the swaying's way, in weights
SCATTER = 0.05  # s.d. of every joint's own friction over its limit after a move
PUT_DOWN_SCATTER = 0.35  # the same after putting down


def approach_displacements(
    reference: Reference,
    planned: np.ndarray,
    columns: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    closed: np.ndarray,
) -> np.ndarray:
    """How far every coordinate would go if it went on as it arrives, (b, n) [rad].

    The torso comes in on a straight line, and both feet stand: the closure's derivative gives
    the rates of what lies between them; other joints go straight.

    Args:
        reference: the solved postures. planned: their planned joint angles, (k, n_joints).
        columns: coordinates that the joints' servos turn, (n_joints,).
        start, end: numbers of the postures between which the robot moves, (b,).
        closed: whether both feet stand; on one foot all joints go straight, (b,) bool.
    """
    n = reference.state.angles.shape[-1]
    way = planned[end] - planned[start]
    if closed.any():
        way[closed] = _closed_displacements(reference, way[closed], columns, start[closed], end[closed])
    out = np.zeros((len(end), n))
    out[:, columns] = way
    return out


def _closed_displacements(
    reference: Reference, way: np.ndarray, columns: np.ndarray, start: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """The same of the joints where both feet stand, from their straight way, (b, n_joints)."""
    n = reference.state.angles.shape[-1]
    closure = reference.slope[end][:, 6 + n :]
    first, last = (reference.state.rotation[which] for which in (start, end))
    there = reference.state.position[end] - reference.state.position[start]
    step = np.concatenate([there, _rotation_vector(last @ first.transpose(0, 2, 1))], axis=-1)
    joints = closure[:, :, 6 : 6 + n][:, :, columns]
    between = np.abs(joints).max(axis=(0, 1)) > 0
    rates = -(np.linalg.pinv(joints[..., between]) @ (closure[..., :6] @ step[..., None]))[..., 0]
    way = way.copy()
    way[:, between] = rates
    return way


def sway_displacements(
    reference: Reference, weight: float, which: np.ndarray, push: np.ndarray
) -> np.ndarray:
    """Way of every coordinate under a push at the torso, (b, n) [rad].

    Args:
        weight: of the robot [N]. which: numbers of the postures, (b,). push: standard normal, (b, 2).
    """
    n = reference.state.angles.shape[-1]
    yielding = -reference.inverse[:, 6 : 6 + n, :2]
    return SWAY * weight * (yielding[which] @ push[..., None])[..., 0]


def friction_at_rest(
    limit: np.ndarray, way: np.ndarray, moved: np.ndarray, move_time: float, scatter: np.ndarray
) -> np.ndarray:
    """Torques of dry friction at rest, (..., n) [Nm].

    Args:
        limit: dry friction, (n,) [Nm]. way: of path and swaying together, (..., n) [rad].
        moved: whether the posture was reached by moving, else by putting down, (...,) bool.
        move_time: [s]. scatter: standard normal, (..., n).
    """
    short = SHORT_WAY * (move_time / REFERENCE_TIME) ** 3
    spread = np.where(moved, SCATTER, PUT_DOWN_SCATTER)[..., None]
    share = spread * scatter - way / np.sqrt(way**2 + short**2)
    return limit * np.clip(share, -1.0, 1.0)


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Of rotation matrices by less than half a turn, (..., 3) [rad]."""
    odd = axial_vector(rotation)
    sine = np.linalg.norm(odd, axis=-1, keepdims=True)
    cosine = (np.trace(rotation, axis1=-2, axis2=-1)[..., None] - 1) / 2
    return odd * np.arctan2(sine, cosine) / np.maximum(sine, 1e-12)
