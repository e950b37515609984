"""The derivative of the residual by the state, in closed form where the mechanism allows it.

A hinge turns all bodies behind it about its axis w through its anchor o. The forces keep their direction, so
that the moment of the loads behind a body changes by sum (w x (c - o)) x f = B w - w tr B with
B = sum (c - o) f'. The sums of c f' are taken from the leaves to the torso, as those of the loads are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.sim.statics.forces import (
    WRENCH_UNIT,
    Load,
    State,
    body_frames,
    body_loads,
    contact_deflection,
    cross,
    drives,
    rotation_matrix,
)
from tulip_testbed.sim.statics.mechanism import HINGE, Mechanism

STEP = 1e-6  # rad or m, of the finite differences of servos, stops and springs


def has_closed_slope(m: Mechanism) -> bool:
    """Return whether `closed_slope` knows all that the mechanism has."""
    hinges = all(joint.kind == HINGE for body in m.bodies for joint in body.joints)
    return hinges and not m.ropes and not any(m.rocking)


def closed_slope(m: Mechanism, state: State, load: Load) -> np.ndarray:
    """Compute the derivative of `residual` by the state's change, (b, s, s).

    Args:
        state: a flat batch, (b,).
    """
    count, n = state.angles.shape
    frames, axis_list, anchor_list = body_frames(m, state)
    force, moment = body_loads(m, state, load, frames)
    shape = (count, 3)
    force, moment = (np.stack([np.broadcast_to(one, shape) for one in part], 1) for part in (force, moment))
    at = [frames[s][0] + frames[s][1] @ point for s, point in zip(m.soles, m.sole_points, strict=True)]
    spread = np.zeros((count, len(m.bodies), 3, 3))
    for number, (place, rotation) in enumerate(frames):
        center = place + (rotation @ load.center[..., number, :, None])[..., 0]
        weight = load.mass[..., number, None] * m.gravity
        spread[:, number] = center[..., :, None] * weight[..., None, :]
    for side, sole in enumerate(m.soles):
        spread[:, sole] += at[side][:, :, None] * state.wrench[:, side, None, :3]
    for number in range(len(m.bodies) - 1, 0, -1):
        parent = m.bodies[number].parent
        for part in (force, moment, spread):
            part[:, parent] += part[:, number]

    owner, order = np.zeros(n, int), np.zeros(n, int)
    for number, body in enumerate(m.bodies):
        for place_in_body, joint in enumerate(body.joints):
            owner[joint.column], order[joint.column] = number, place_in_body
    behind = np.zeros((len(m.bodies), len(m.bodies)), bool)  # [a, b]: body b hangs on a, or is it
    for number in range(len(m.bodies)):
        behind[number, m.subtree(number)] = True
    axes, anchors = np.stack(axis_list, 1), np.stack(anchor_list, 1)
    own_force, own_moment = force[:, owner], moment[:, owner] - cross(anchors, force[:, owner])

    out = np.zeros((count, 18 + n, 18 + n))
    closure = out[:, 6 + n :].reshape(count, 2, 6, 18 + n)
    closure[:, :, np.arange(3), np.arange(3)] = 1.0
    turned = _turned_soles(m, load, frames)
    torso = [(np.broadcast_to(row, (count, 3)), state.position, 0, -1) for row in np.eye(3)]
    joints = [(axes[:, j], anchors[:, j], int(owner[j]), int(order[j])) for j in range(n)]
    for column, (axis, anchor, body, number) in enumerate([*torso, *joints], start=3):
        change = _change(spread[:, body], force[:, body], axis, anchor)
        out[:, 3:6, column] = change
        moved = behind[body, owner] & ((owner != body) | (order > number))
        before = behind[owner, body] & ~moved
        out[:, 6 : 6 + n, column][:, before] = (axes[:, before] * change[:, None]).sum(axis=-1)
        a, o, f = axes[:, moved], anchors[:, moved], own_force[:, moved]
        w = axis[:, None]
        own = _change(spread[:, owner[moved]], f, w, anchor[:, None])
        own -= cross(cross(w, o - anchor[:, None]), f)
        out[:, 6 : 6 + n, column][:, moved] = (cross(w, a) * own_moment[:, moved] + a * own).sum(axis=-1)
        for side, sole in enumerate(m.soles):
            if behind[body, sole]:
                closure[:, side, :3, column] = cross(axis, at[side] - anchor)
                closure[:, side, 3:, column] = (turned[side] @ axis[..., None])[..., 0]
    for side, sole in enumerate(m.soles):
        carries = behind[owner, sole]
        for k, unit in enumerate(np.eye(3)):
            push, twist = (6 + n + 6 * side + part + k for part in (0, 3))
            out[:, k, push] = 1.0
            out[:, 3:6, push] = cross(at[side] - state.position, unit)
            out[:, 3 + k, twist] = 1.0
            arm = cross(at[side][:, None] - anchors[:, carries], unit)
            out[:, 6 : 6 + n, push][:, carries] = (axes[:, carries] * arm).sum(axis=-1)
            out[:, 6 : 6 + n, twist][:, carries] = axes[:, carries, k]
        feet = load.feet[..., side, :], load.plates[..., side, :]
        still = contact_deflection(m, side, np.zeros((count, 6)), *feet)
        for k, unit in enumerate(np.eye(6)):
            pressed = contact_deflection(m, side, np.broadcast_to(unit, (count, 6)), *feet) - still
            closure[:, side, 2:5, 6 + n + 6 * side + k] -= pressed
    own = np.arange(6)
    lifted = np.zeros((2, 6, 18 + n))
    for side in range(2):
        lifted[side, own, 6 + n + 6 * side + own] = 1 / WRENCH_UNIT
    closure[:] = np.where(load.foot_contact[..., None, None], closure, lifted)
    for j, step in enumerate(STEP * np.eye(n)):
        ahead, behind_it = (drives(m, replace(state, angles=state.angles + s * step), load) for s in (1, -1))
        out[:, 6 : 6 + n, 6 + j] += (ahead - behind_it) / (2 * STEP)
    return out


def _change(spread: np.ndarray, force: np.ndarray, axis: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """Return the change of moment of forces whose points turn about an axis, (..., 3)."""
    about = spread - anchor[..., :, None] * force[..., None, :]
    trace = np.trace(about, axis1=-2, axis2=-1)
    return (about @ axis[..., None])[..., 0] - axis * trace[..., None]


def _turned_soles(m: Mechanism, load: Load, frames: list) -> list[np.ndarray]:
    """Return the derivative of the soles' error of rotation by a rotation, (b, 3, 3) each."""
    out = []
    for side, sole in enumerate(m.soles):
        upright = rotation_matrix(load.feet[..., side, 2:] * np.array([0.0, 0.0, 1.0]))
        error = frames[sole][1] @ np.swapaxes(upright, -1, -2)
        trace = np.trace(error, axis1=-2, axis2=-1)[..., None, None]
        out.append((trace * np.eye(3) - error) / 2)
    return out
