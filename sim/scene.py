"""The scene: the robot on its two plates, as one virtual laboratory wants it."""

from __future__ import annotations

import mujoco
import numpy as np

from sim.compliance import Compliance, add_compliance
from sim.control import add_servos
from sim.drives import Drives, add_drives
from sim.model import Robot, load_spec
from sim.plates import place_plates
from sim.rig import Rig

# At MuJoCo's 1e-8 the solver stops so early that forces flicker and feet creep several times faster.
SOLVER_TOLERANCE = 1e-12


def load_scene(robot: Robot) -> mujoco.MjSpec:
    """The nominal robot on two plates, driven by plain motors.

    Raises:
        InputError: the file is missing or is no MJCF.
    """
    return load_spec(robot.scene)


def laboratory_scene(rig: Rig, plate_poses: np.ndarray) -> mujoco.MjSpec:
    """The scene with the rig's drives, servos and compliance, the plates where they lie, and its edit.

    Args:
        plate_poses: of the right and left plate in the base frame, (2, 3) [m, m, rad].

    Raises:
        InputError: the scene is missing or is no MJCF.
    """
    spec = load_scene(rig.robot)
    add_drives(spec, rig.drives)
    add_compliance(spec, rig.robot, rig.compliance)
    if rig.drives != Drives() or rig.compliance != Compliance():
        for key in list(spec.keys):  # keyframes of the robot as it was
            spec.delete(key)
    add_servos(spec, rig.controller)
    place_plates(spec, plate_poses)
    spec.option.tolerance = SOLVER_TOLERANCE
    if rig.edit is not None:
        rig.edit(spec)
    return spec
