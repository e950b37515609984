"""The robot that really stands in a laboratory whose effects change it."""

import mujoco
import numpy as np

from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.scene import load_scene
from tulip_testbed.sim.specs import compile_spec


def true_model(rig: Rig) -> mujoco.MjModel:
    """Compile the robot that stands in a laboratory at first, alone: with its own masses and lengths.

    Joints that yield and ropes, which the nominal robot does not have, are left out; so is what lies under
    a corner of a sole.

    Raises:
        InputError: an edit with which there is no robot.
    """
    spec = load_scene(rig.robot)
    if rig.edit is not None:
        joints, tendons = ({part.name for part in parts} for parts in (spec.joints, spec.tendons))
        corners = [spec.geom(name) for name in rig.robot.sole_geoms]
        soles = [corner.pos.copy() for corner in corners]
        rig.edit(spec)
        for corner, place in zip(corners, soles, strict=True):
            corner.pos = place
        for part in [part for part in spec.tendons if part.name not in tendons]:
            spec.delete(part)
        for part in [part for part in spec.joints if part.name not in joints]:
            spec.delete(part)
    for plate in PLATES:
        spec.delete(spec.body(f"{plate}_plate"))
    for key in list(spec.keys):
        spec.delete(key)
    return compile_spec(spec, str(rig.robot.path))


def true_base_parameters(rig: Rig, support: str = "double") -> np.ndarray:
    """Compute the base parameters of that robot, with its own lengths, (p,) [m]."""
    model = true_model(rig)
    return base_parameters(rig.robot, model, support).values(standard_parameters(model))
