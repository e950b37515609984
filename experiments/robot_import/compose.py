"""Build the robot as the laboratory needs it, as MJCF with no other files."""

from __future__ import annotations

import mujoco

from tulip_testbed.experiments.robot_import.completed_drives import complete_drives
from tulip_testbed.experiments.robot_import.feet import Stance
from tulip_testbed.experiments.robot_import.skeleton import Skeleton, tree_spec
from tulip_testbed.measurements.cells import CORNERS

CORNER_RADIUS = 0.002  # m
DARKEST = 0.35  # colours are lightened, so that black robots can be seen
DIGITS = 5  # of the vertices of meshes [m]


def compose(
    name: str, skeleton: Skeleton, stance: Stance, torque: dict[str, float], leg: float
) -> tuple[mujoco.MjSpec, list[str]]:
    """Return the robot alone: links, hinges with complete drives, motors, shapes and sole corners.

    Args:
        torque, leg: see `complete_drives`.

    Returns:
        the robot; what was assumed of its drives.
    """
    frames = {1: (skeleton.pose(1)[0], stance.axes)} | {f.link: (f.origin, f.axes) for f in stance.feet}
    spec = tree_spec(skeleton.model, skeleton.data, 1, skeleton.hinges(), frames, DIGITS)
    spec.modelname = name
    for geom in spec.geoms:
        geom.rgba = [*(DARKEST + (1 - DARKEST) * geom.rgba[:3]), 1.0]
    assumed = complete_drives(spec, torque, skeleton.mass, leg)
    for foot in stance.feet:
        body = spec.body(skeleton.name(foot.link))
        for corner, (x, y, z) in zip(CORNERS, foot.corners, strict=True):
            body.add_geom(
                name=f"{body.name}_{corner}",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[CORNER_RADIUS, 0, 0],
                pos=[x, y, z + CORNER_RADIUS],
                rgba=[0.1, 0.1, 0.1, 1],
                group=3,
                contype=1,
                conaffinity=0,
                mass=0.0,
            )
    return spec, assumed
