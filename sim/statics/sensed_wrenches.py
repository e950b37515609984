"""Wrenches that sensors in or under the feet feel, at solved equilibria."""

from __future__ import annotations

import numpy as np

from tulip_testbed.sim.statics.forces import Load, State, body_frames, body_loads, cross, rotation_matrix
from tulip_testbed.sim.statics.mechanism import Mechanism
from tulip_testbed.sim.wrench_sensors import in_frame


def foot_wrenches(mechanism: Mechanism, state: State, load: Load) -> np.ndarray:
    """Return what the feet pass on to the legs: the ground's wrench and their weight, (..., 2, 6) [N, Nm].

    The moment is about the foot's origin, and both are in the foot's axes.
    """
    m, sides = mechanism, []
    frames, _, _ = body_frames(m, state)
    force, moment = body_loads(m, state, load, frames)
    for foot in m.feet:
        (place, rotation), below = frames[foot], m.subtree(foot)
        push = sum(force[k] for k in below) + np.zeros_like(place)
        twist = sum(moment[k] for k in below) - cross(place, push)
        both = np.stack([push, twist], axis=-2) @ rotation
        sides.append(both.reshape(*both.shape[:-2], 6))
    return np.stack(sides, axis=-2)


def sole_wrenches(mechanism: Mechanism, state: State) -> np.ndarray:
    """Return the ground's wrench about each foot's origin in the foot's axes, (..., 2, 6) [N, Nm]."""
    frames, _, _ = body_frames(mechanism, state)
    ground = _ground_wrenches(mechanism, state, frames)
    sides = [
        in_frame(frames[foot][1], frames[foot][0], ground[..., side, :])
        for side, foot in enumerate(mechanism.feet)
    ]
    return np.stack(sides, axis=-2)


def plate_wrenches(mechanism: Mechanism, state: State, load: Load) -> np.ndarray:
    """Return the wrench of each level plate on its foot in the frame of its top, (..., 2, 6) [N, Nm]."""
    frames, _, _ = body_frames(mechanism, state)
    ground = _ground_wrenches(mechanism, state, frames)
    plates = np.broadcast_to(load.plates, (*ground.shape[:-1], 3))
    upright = rotation_matrix(plates[..., 2:] * [0.0, 0.0, 1.0])
    at = plates * [1.0, 1.0, 0.0]  # z = 0 is the boards' top
    return in_frame(upright, at, ground)


def _ground_wrenches(m: Mechanism, state: State, frames: list) -> np.ndarray:
    """Return the ground's wrenches on both soles about the world's origin, (..., 2, 6) [N, Nm]."""
    sides = []
    for side, (sole, point) in enumerate(zip(m.soles, m.sole_points, strict=True)):
        push, twist = state.wrench[..., side, :3], state.wrench[..., side, 3:]
        at = frames[sole][0] + frames[sole][1] @ point
        sides.append(np.concatenate([push, twist + cross(at, push)], axis=-1))
    return np.stack(sides, axis=-2)
