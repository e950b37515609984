"""The scene: the robot on its two plates, as one virtual laboratory wants it."""

from __future__ import annotations

import mujoco
import numpy as np

from sim.control import add_servos
from sim.model import Robot, load_spec
from sim.plates import place_plates
from sim.rig import Rig


def load_scene(robot: Robot) -> mujoco.MjSpec:
    """The nominal robot on two plates, driven by plain motors.

    Raises:
        InputError: the file is missing or is no MJCF.
    """
    return load_spec(robot.scene, robot.folder)


def laboratory_scene(rig: Rig, plate_poses: np.ndarray) -> mujoco.MjSpec:
    """The scene with the rig's servos, the plates where they lie, and the rig's own edit.

    Args:
        plate_poses: of the right and left plate in the base frame, (2, 3) [m, m, rad].

    Raises:
        InputError: the scene is missing or is no MJCF.
    """
    spec = load_scene(rig.robot)
    add_servos(spec, rig.controller)
    place_plates(spec, plate_poses)
    if rig.edit is not None:
        rig.edit(spec)
    return spec
