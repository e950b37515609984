"""Wrenches that sensors in or under the feet feel, at solved equilibria."""

import numpy as np

from tulip_testbed.sim.sensors import ANKLE, PLATE
from tulip_testbed.sim.statics.forces import (
    Frames,
    Load,
    StaticState,
    body_frames,
    body_loads,
    cross,
    rotation_matrix,
)
from tulip_testbed.sim.statics.mechanism import Mechanism
from tulip_testbed.sim.statics.solved_plan import SolvedPlan
from tulip_testbed.sim.wrench_sensors import frame_of, in_frame, mountings


def sensed_wrenches(solved_plan: SolvedPlan, state: StaticState, load: Load) -> np.ndarray:
    """Return the true wrenches where they are read, (..., 2, 6) [N, Nm]; (..., 0, 6) if nowhere."""
    m, where, sensors = solved_plan.mechanism, solved_plan.rig.wrenches_at, solved_plan.rig.sensors.wrench
    if not where:
        return np.zeros((*state.angles.shape[:-1], 0, 6))
    frames = body_frames(m, state)
    if sensors is None or where == PLATE:
        return _on_plates(load, _ground_wrenches(m, state, frames))
    in_feet = _of_feet(m, state, load, frames) if where == ANKLE else _on_soles(m, state, frames)
    poses = mountings(sensors, solved_plan.rig.robot)
    sides = [in_frame(*frame_of(pose), in_feet[..., side, :]) for side, pose in enumerate(poses)]
    return np.stack(sides, axis=-2)


def _of_feet(m: Mechanism, state: StaticState, load: Load, frames: Frames) -> np.ndarray:
    """Return what the feet pass on to the legs: the ground's wrench and their weight, (..., 2, 6) [N, Nm].

    The moment is about the foot's origin, and both are in the foot's axes.
    """
    force, moment = body_loads(m, state, load, frames)
    sides = []
    for foot in m.feet:
        push = force[m.behind[foot]].sum(axis=0)
        twist = moment[m.behind[foot]].sum(axis=0) - cross(frames.place[foot], push)
        both = np.stack([push, twist], axis=-2) @ frames.rotation[foot]
        sides.append(both.reshape(*both.shape[:-2], 6))
    return np.stack(sides, axis=-2)


def _on_soles(m: Mechanism, state: StaticState, frames: Frames) -> np.ndarray:
    """Return the ground's wrench about each foot's origin in the foot's axes, (..., 2, 6) [N, Nm]."""
    ground = _ground_wrenches(m, state, frames)
    sides = [
        in_frame(frames.rotation[foot], frames.place[foot], ground[..., k, :])
        for k, foot in enumerate(m.feet)
    ]
    return np.stack(sides, axis=-2)


def _on_plates(load: Load, ground: np.ndarray) -> np.ndarray:
    """Return the wrench of each level plate on its foot in the frame of its top, (..., 2, 6) [N, Nm]."""
    plates = np.broadcast_to(load.plates, (*ground.shape[:-1], 3))
    upright = rotation_matrix(plates[..., 2:] * [0.0, 0.0, 1.0])
    at = plates * [1.0, 1.0, 0.0]  # z = 0 is the boards' top
    return in_frame(upright, at, ground)


def _ground_wrenches(m: Mechanism, state: StaticState, frames: Frames) -> np.ndarray:
    """Return the ground's wrenches on both soles about the world's origin, (..., 2, 6) [N, Nm]."""
    sides = []
    for side, (sole, point) in enumerate(zip(m.soles, m.sole_points, strict=True)):
        push, twist = state.wrench[..., side, :3], state.wrench[..., side, 3:]
        at = frames.place[sole] + frames.rotation[sole] @ point
        sides.append(np.concatenate([push, twist + cross(at, push)], axis=-1))
    return np.stack(sides, axis=-2)
