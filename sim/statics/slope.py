"""The derivative of the residual by the state, in closed form where the mechanism allows it.

A hinge turns all bodies behind it about its axis w through its anchor o. The forces keep their direction, so
that the moment of the loads behind a body changes by sum (w x (c - o)) x f = B w - w tr B with
B = sum (c - o) f'. The sums of c f' are taken from the leaves to the torso, as those of the loads are.
"""

from dataclasses import replace

import numpy as np

from tulip_testbed.sim.statics.forces import (
    WRENCH_UNIT,
    Frames,
    Load,
    StaticState,
    body_frames,
    body_loads,
    contact_deflection,
    cross,
    dot,
    drives,
    rotation_matrix,
    weights,
)
from tulip_testbed.sim.statics.mechanism import HINGE, Mechanism

STEP = 1e-6  # rad or m, of the finite differences of servos, stops and springs


def has_closed_slope(m: Mechanism) -> bool:
    """Return whether `closed_slope` knows all that the mechanism has."""
    hinges = all(joint.kind == HINGE for body in m.bodies for joint in body.joints)
    return hinges and not m.ropes and not any(m.rocking)


def closed_slope(m: Mechanism, state: StaticState, load: Load) -> np.ndarray:
    """Compute the derivative of `residual` by the change of a flat batch of states, (b, s, s)."""
    count, n = state.angles.shape
    frames = body_frames(m, state)
    at = [
        frames.place[s] + frames.rotation[s] @ point for s, point in zip(m.soles, m.sole_points, strict=True)
    ]
    force, moment, spread = _sums_behind(m, state, load, frames, at)
    # The torso's rotation about the world's axes, then the coordinates.
    position = np.broadcast_to(state.position[:, None], (count, 3, 3))
    axes = np.concatenate([np.broadcast_to(np.eye(3), (count, 3, 3)), frames.axis.swapaxes(0, 1)], axis=1)
    anchors = np.concatenate([position, frames.anchor.swapaxes(0, 1)], axis=1)
    body = np.concatenate([np.zeros(3, int), m.owner])
    order = np.concatenate([np.full(3, -1), m.order])
    moved = m.behind[np.ix_(body, m.owner)] & ((body[:, None] != m.owner) | (order[:, None] < m.order))
    before = m.behind[np.ix_(m.owner, body)].T & ~moved

    out = np.zeros((count, 18 + n, 18 + n))
    turning, own = slice(3, 6 + n), slice(6, 6 + n)
    trace = np.trace(spread, axis1=2, axis2=3)
    f, o, w = force[:, body], anchors, axes
    change = (
        (spread[:, body] @ w[..., None])[..., 0]
        - o * dot(f, w)[..., None]
        - w * (trace[:, body, None] - dot(o, f)[..., None])
    )
    out[:, 3:6, turning] = change.mT
    a, f, o = axes[:, 3:], f[:, 3:], anchors[:, 3:]  # of the coordinates whose torque changes
    twist, across = moment[:, m.owner] - cross(o, f), cross(f, a)
    turned = cross(a, twist) + (spread[:, m.owner].mT @ a[..., None])[..., 0]
    turned -= a * trace[:, m.owner, None] + cross(o, across)
    own_change = axes @ turned.mT + cross(axes, anchors) @ across.mT
    own_change += (axes @ a.mT) * (anchors @ f.mT) - (anchors @ a.mT) * (axes @ f.mT)
    out[:, own, turning] = np.where(moved, own_change, np.where(before, change @ a.mT, 0.0)).mT
    closure = out[:, 6 + n :].reshape(count, 2, 6, 18 + n)
    closure[:, :, np.arange(3), np.arange(3)] = 1.0
    soles = _turned_soles(m, load, frames)
    for side, sole in enumerate(m.soles):
        carries = m.behind[body, sole, None]
        lever = np.where(carries, cross(axes, at[side][:, None] - anchors), 0.0)
        closure[:, side, :3, turning] = lever.mT
        closure[:, side, 3:, turning] = soles[side] @ np.where(carries, axes, 0.0).mT
        push, torque = (slice(first, first + 3) for first in (6 + n + 6 * side, 9 + n + 6 * side))
        out[:, :3, push] = out[:, 3:6, torque] = np.eye(3)
        out[:, 3:6, push] = cross((at[side] - state.position)[:, None], np.eye(3)).mT
        out[:, own, push] = lever[:, 3:]
        out[:, own, torque] = np.where(carries[3:], a, 0.0)
        feet = load.feet[..., side, :], load.plates[..., side, :]
        units = np.concatenate([np.zeros((1, 6)), np.eye(6)])[:, None]
        still, *pressed = contact_deflection(m, side, np.broadcast_to(units, (7, count, 6)), *feet)
        closure[:, side, 2:5, 6 + n + 6 * side : 12 + n + 6 * side] -= (
            np.stack(pressed, -1) - still[..., None]
        )
    each = np.arange(6)
    lifted = np.zeros((2, 6, 18 + n))
    for side in range(2):
        lifted[side, each, 6 + n + 6 * side + each] = 1 / WRENCH_UNIT
    closure[:] = np.where(load.foot_contact[..., None, None], closure, lifted)
    out[:, own, own] += _of_drives(m, state, load)
    return out


def _sums_behind(
    m: Mechanism, state: StaticState, load: Load, frames: Frames, soles: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum forces (b, nb, 3), moments and c f' (b, nb, 3, 3) of the loads over each body and all behind it."""
    force, moment = body_loads(m, state, load, frames)
    weight, center = weights(m, state, load, frames)
    spread = center[..., :, None] * weight[..., None, :]
    for side, sole in enumerate(m.soles):
        spread[sole] += soles[side][:, :, None] * state.wrench[:, side, None, :3]
    force, moment, spread = (m.sums_behind(part).swapaxes(0, 1) for part in (force, moment, spread))
    return force, moment, spread


def _of_drives(m: Mechanism, state: StaticState, load: Load) -> np.ndarray:
    """Return the derivative of `drives` by the coordinates, by central differences, (b, n, n)."""
    n = state.angles.shape[-1]
    if m.springs:
        steps = STEP * np.eye(n)[:, None]
        ahead, behind = (drives(m, replace(state, angles=state.angles + s * steps), load) for s in (1, -1))
        return np.moveaxis(ahead - behind, 0, -1) / (2 * STEP)
    # Without springs of several coordinates the torque on each depends on itself alone.
    ahead, behind = (drives(m, replace(state, angles=state.angles + s * STEP), load) for s in (1, -1))
    return ((ahead - behind) / (2 * STEP))[..., None] * np.eye(n)


def _turned_soles(m: Mechanism, load: Load, frames: Frames) -> list[np.ndarray]:
    """Return the derivative of the soles' error of rotation by a rotation, (b, 3, 3) each."""
    out = []
    for side, sole in enumerate(m.soles):
        upright = rotation_matrix(load.feet[..., side, 2:] * np.array([0.0, 0.0, 1.0]))
        error = frames.rotation[sole] @ np.swapaxes(upright, -1, -2)
        trace = np.trace(error, axis1=-2, axis2=-1)[..., None, None]
        out.append((trace * np.eye(3) - error) / 2)
    return out
