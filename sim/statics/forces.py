"""Forces and closure residual of the mechanism at given coordinates, batched over leading dimensions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tulip_testbed.sim.statics.mechanism import HINGE, Joint, Mechanism
from tulip_testbed.sim.statics.soft_constraints import stop_torques

WRENCH_UNIT = 100.0  # N or Nm that count as one metre in the closure residual of an unloaded foot


@dataclass(frozen=True)
class StaticState:
    """State of the mechanism and the wrenches on its feet; leading dimensions ... are the batch.

    Attributes:
        position, rotation: pose of the torso, (..., 3) [m] and (..., 3, 3).
        angles: coordinates, (..., n) [rad, m].
        wrench: force and moment about the sole point on the right and left sole, (..., 2, 6) [N, Nm].
    """

    position: np.ndarray
    rotation: np.ndarray
    angles: np.ndarray
    wrench: np.ndarray

    def take(self, which: np.ndarray) -> StaticState:
        return StaticState(self.position[which], self.rotation[which], self.angles[which], self.wrench[which])

    def put(self, which: np.ndarray, other: StaticState) -> None:
        self.position[which], self.rotation[which] = other.position, other.rotation
        self.angles[which], self.wrench[which] = other.angles, other.wrench

    def moved(self, change: np.ndarray) -> StaticState:
        """Return the state after a change of torso, coordinates and wrenches, (..., 6 + n + 12)."""
        n = self.angles.shape[-1]
        return StaticState(
            self.position + change[..., :3],
            rotation_matrix(change[..., 3:6]) @ self.rotation,
            self.angles + change[..., 6 : 6 + n],
            self.wrench + change[..., 6 + n :].reshape(*change.shape[:-1], 2, 6),
        )


@dataclass(frozen=True)
class Load:
    """Loads and boundary conditions of the mechanism; every array broadcasts over the batch.

    Attributes:
        command: commanded joint angles, (..., n_joints) [rad].
        friction: torque of dry friction on every coordinate, (..., n) [Nm].
        feet: planar poses of both soles, (..., 2, 3) [m, m, rad].
        plates: planar poses of both plates, (..., 2, 3) [m, m, rad].
        mass, center: masses and centres of mass of the bodies, (..., nb) [kg], (..., nb, 3) [m].
        foot_contact: whether each foot is on its plate, (..., 2) bool.
        gravity: of every item, (..., 3) [m/s2]; None: the mechanism's.
    """

    command: np.ndarray
    friction: np.ndarray
    feet: np.ndarray
    plates: np.ndarray
    mass: np.ndarray
    center: np.ndarray
    foot_contact: np.ndarray = field(default_factory=lambda: np.ones(2, bool))
    gravity: np.ndarray | None = None

    def take(self, which: np.ndarray) -> Load:
        """Select items of a flat batch; shared arrays stay unchanged."""
        planes = ("feet", "plates", "center")  # arrays of two dimensions for every item
        given = {name: part for name, part in vars(self).items() if part is not None}
        own = {name: 2 if name in planes else 1 for name in given}
        return Load(**{name: part[which] if part.ndim > own[name] else part for name, part in given.items()})


def residual(mechanism: Mechanism, state: StaticState, load: Load) -> np.ndarray:
    """Compute the residual of equilibrium and closure, (..., 6 + n + 12) [N, Nm, m, rad].

    Forces and moments of all loads about the world's origin are summed from the leaves to the torso; a
    hinge transmits the component along its axis (principle of virtual work). The last twelve rows are the
    pose errors of both soles, or the wrench on a foot in the air.
    """
    m = mechanism
    frames = body_frames(m, state)
    force, moment = (m.sums_behind(part) for part in body_loads(m, state, load, frames))
    n = state.angles.shape[-1]
    shape = np.broadcast_shapes(state.angles.shape[:-1], load.command.shape[:-1], load.mass.shape[:-1])
    out = np.empty((*shape, 6 + n + 12))
    out[..., :3] = force[0]
    out[..., 3:6] = moment[0] - cross(state.position, force[0])
    behind, twist = force[m.owner], moment[m.owner]
    component = dot(frames.axis, twist - cross(frames.anchor, behind))
    if m.slides.any():
        component[m.slides] = dot(frames.axis, behind)[m.slides]
    out[..., 6 : 6 + n] = np.moveaxis(component, 0, -1) + drives(m, state, load)
    # A foot in the air bears no load, at any pose.
    closure = np.where(
        load.foot_contact[..., None], _closure(m, state, load, frames), state.wrench / WRENCH_UNIT
    )
    out[..., 6 + n :] = closure.reshape(*shape, 12)
    return out


def sole_poses(mechanism: Mechanism, state: StaticState) -> np.ndarray:
    """Return the planar poses of both soles in the world, (..., 2, 3) [m, m, rad]."""
    frames = body_frames(mechanism, state)
    poses = []
    for sole, point in zip(mechanism.soles, mechanism.sole_points, strict=True):
        place, rotation = frames.place[sole], frames.rotation[sole]
        yaw = np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])
        poses.append(np.concatenate([(place + rotation @ point)[..., :2], yaw[..., None]], axis=-1))
    return np.stack(poses, axis=-2)


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of rotation vectors, (..., 3) -> (..., 3, 3)."""
    angle = np.sqrt((vector * vector).sum(axis=-1))
    sine, cosine = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    x, y, z = (vector[..., k] for k in range(3))
    out = np.empty((*vector.shape, 3))
    for (i, j), first, second in (((0, 1), z, (x, y)), ((1, 2), x, (y, z)), ((2, 0), y, (z, x))):
        out[..., i, j] = cosine * second[0] * second[1] - sine * first
        out[..., j, i] = cosine * second[0] * second[1] + sine * first
    squares = vector * vector
    for k in range(3):
        out[..., k, k] = 1 - cosine * (squares.sum(axis=-1) - squares[..., k])
    return out


def axial_vector(rotation: np.ndarray) -> np.ndarray:
    """Return axis times sine of the angle of rotation matrices, (..., 3, 3) -> (..., 3)."""
    return (
        np.stack(
            [
                rotation[..., 2, 1] - rotation[..., 1, 2],
                rotation[..., 0, 2] - rotation[..., 2, 0],
                rotation[..., 1, 0] - rotation[..., 0, 1],
            ],
            axis=-1,
        )
        / 2
    )


@dataclass(frozen=True)
class Frames:
    """Bodies and coordinates in the world; the dimension of these comes before the batch.

    Attributes:
        place, rotation: of every body, (nb, ..., 3) [m] and (nb, ..., 3, 3).
        axis, anchor: of every coordinate, (n, ..., 3) [-], [m].
    """

    place: np.ndarray
    rotation: np.ndarray
    axis: np.ndarray
    anchor: np.ndarray


def body_frames(m: Mechanism, state: StaticState) -> Frames:
    """Return place and rotation of every body, and axis and anchor of every coordinate, in the world."""
    batch, count, n = state.angles.shape[:-1], len(m.bodies), state.angles.shape[-1]
    places, rotations = np.empty((count, *batch, 3)), np.empty((count, *batch, 3, 3))
    axes, anchors = np.empty((n, *batch, 3)), np.empty((n, *batch, 3))
    places[0], rotations[0] = state.position, state.rotation
    for number, body in enumerate(m.bodies[1:], start=1):
        place, rotation = places[body.parent], rotations[body.parent]
        place = place + rotation @ body.position
        if body.turned:
            rotation = rotation @ body.rotation
        for joint in body.joints:
            value = state.angles[..., joint.column]
            value = value - joint.zero if joint.zero else value
            axis = rotation @ joint.axis
            if joint.kind == HINGE:
                anchor = place + rotation @ joint.anchor if joint.off_origin else place
                rotation = _turned(rotation, joint, value)
                place = anchor - rotation @ joint.anchor if joint.off_origin else place
            else:
                anchor = place
                place = place + axis * value[..., None]
            axes[joint.column], anchors[joint.column] = axis, anchor
        places[number], rotations[number] = place, rotation
    return Frames(places, rotations, axes, anchors)


def _turned(rotation: np.ndarray, joint: Joint, angle: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    if (k := joint.along) is not None:  # two columns mix, the third stays
        i, j = (k + 1) % 3, (k + 2) % 3
        out = np.empty((*angle.shape, 3, 3))
        first, second = rotation[..., i], rotation[..., j]
        c, s = cosine[..., None], sine[..., None]
        out[..., k] = rotation[..., k]
        out[..., i] = c * first + s * second
        out[..., j] = c * second - s * first
        return out
    return rotation @ rotation_matrix(angle[..., None] * joint.axis)


def body_loads(m: Mechanism, state: StaticState, load: Load, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
    """Return force and moment on every body about the world's origin, (nb, ..., 3) each [N], [Nm]."""
    weight, center = weights(m, state, load, frames)
    force, moment = np.broadcast_to(weight, center.shape).copy(), cross(center, weight)
    for side, (sole, point) in enumerate(zip(m.soles, m.sole_points, strict=True)):
        at = frames.place[sole] + frames.rotation[sole] @ point
        push, twist = state.wrench[..., side, :3], state.wrench[..., side, 3:]
        force[sole] = force[sole] + push
        moment[sole] = moment[sole] + twist + cross(at, push)
    for rope in m.ropes:
        at = frames.place[rope.body] + frames.rotation[rope.body] @ rope.point
        line = rope.anchor - at
        length = np.sqrt(dot(line, line))
        pull = (rope.stiffness * _beyond(length, *rope.length) / length)[..., None] * line
        force[rope.body] = force[rope.body] + pull
        moment[rope.body] = moment[rope.body] + cross(at, pull)
    return force, moment


def weights(m: Mechanism, state: StaticState, load: Load, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
    """Return the weight and the centre of mass of every body in the world, (nb, ..., 3) each [N], [m]."""
    batch = state.angles.ndim - 1
    gravity = m.gravity if load.gravity is None else load.gravity
    center = frames.place + (frames.rotation @ _by_body(load.center, batch)[..., None])[..., 0]
    return _by_body(load.mass[..., None], batch) * gravity, center


def _by_body(values: np.ndarray, batch: int) -> np.ndarray:
    """Return vectors of bodies (..., nb, k) with the bodies first and `batch` dimensions after them."""
    first = np.moveaxis(values, -2, 0)
    return first.reshape(len(first), *[1] * (batch + 2 - first.ndim), *first.shape[1:])


def drives(m: Mechanism, state: StaticState, load: Load) -> np.ndarray:
    """Return the torques of servos, springs and dry friction on the coordinates, (..., n)."""
    out = load.friction - m.stiffness * (state.angles - m.rest) + stop_torques(m.stops, state.angles)
    out[..., m.motors] += np.clip(m.gain * (load.command - state.angles[..., m.motors]), -m.limit, m.limit)
    for stiffness, (low, high), row in m.springs:
        out -= (stiffness * _beyond(state.angles @ row, low, high))[..., None] * row
    return out


def _beyond(length: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return how far a spring's length is outside of its rest range."""
    return length - np.clip(length, low, high)


def _closure(m: Mechanism, state: StaticState, load: Load, frames: Frames) -> np.ndarray:
    """Return the pose errors of both soles against flat on their compliant plates, (..., 2, 6)."""
    rows = []
    for side, (sole, point) in enumerate(zip(m.soles, m.sole_points, strict=True)):
        place, rotation = frames.place[sole], frames.rotation[sole]
        foot = load.feet[..., side, :]
        upright = rotation_matrix(foot[..., 2:] * np.array([0.0, 0.0, 1.0]))
        wanted = np.concatenate([foot[..., :2], np.zeros_like(foot[..., :1])], axis=-1)
        turned = axial_vector(rotation @ np.swapaxes(upright, -1, -2))
        row = np.concatenate([place + rotation @ point - wanted, turned], axis=-1)
        row[..., 2:5] -= contact_deflection(
            m, side, state.wrench[..., side, :], foot, load.plates[..., side, :]
        )
        rows.append(row)
    return np.stack(rows, axis=-2)


def contact_deflection(
    m: Mechanism, side: int, wrench: np.ndarray, foot: np.ndarray, plate: np.ndarray
) -> np.ndarray:
    """Return height, roll and pitch of a sole under load, at its point, (..., 3) [m, rad, rad]."""
    down, tip = board_wrench(m, wrench, foot, plate)
    board = np.concatenate([-down[..., None], tip], axis=-1) @ m.board_compliance[side].T
    if (rocking := m.rocking[side]) is not None:
        board = board + rocking.deflection(down, tip)
    ox, oy = foot[..., 0] - plate[..., 0], foot[..., 1] - plate[..., 1]
    tilt = turned_about_z(board[..., 1:], plate[..., 2])
    height = board[..., 0] + tilt[..., 0] * oy - tilt[..., 1] * ox
    press = np.concatenate([-wrench[..., 2:3], -turned_about_z(wrench[..., 3:5], -foot[..., 2])], axis=-1)
    sole = press @ m.sole_compliance[side].T
    tilt = tilt + turned_about_z(sole[..., 1:], foot[..., 2])
    return np.concatenate([(height + sole[..., 0])[..., None], tilt], axis=-1)


def turned_about_z(vector: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def board_wrench(
    m: Mechanism, wrench: np.ndarray, foot: np.ndarray, plate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the load of a foot on its board.

    Args:
        wrench: wrench on the sole about its point, (..., 6) [N, Nm].
        foot, plate: planar poses, (..., 3) [m, m, rad].

    Returns:
        Downward force, (...,) [N], and roll and pitch moment about the plate's origin on the floor in the
        plate's axes, (..., 2) [Nm].
    """
    force, moment = -wrench[..., :3], -wrench[..., 3:]
    ox, oy = foot[..., 0] - plate[..., 0], foot[..., 1] - plate[..., 1]
    mx = moment[..., 0] + oy * force[..., 2] - m.top_height * force[..., 1]
    my = moment[..., 1] + m.top_height * force[..., 0] - ox * force[..., 2]
    return -force[..., 2], turned_about_z(np.stack([mx, my], axis=-1), -plate[..., 2])


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the inner products along the last axis."""
    return (a * b).sum(axis=-1)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product, faster than numpy.cross."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out = np.empty(np.broadcast(a, b).shape)
    np.subtract(ay * bz, az * by, out=out[..., 0])
    np.subtract(az * bx, ax * bz, out=out[..., 1])
    np.subtract(ax * by, ay * bx, out=out[..., 2])
    return out
