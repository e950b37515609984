"""TULip at another size: lengths by a factor, masses by its cube, torques by its fourth power."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.shipped import TULIP

LENGTHS = ("swing_x", "swing_y", "least_height", "stability_margin", "foot_clearance", "sole_margin")


def write_scaled_robot(folder: Path, factor: float, planning: str = "") -> Robot:
    """Write TULip's MJCF and description, scaled, into a new folder and load the robot.

    Args:
        planning: further lines of the [planning] table.
    """
    folder.mkdir(parents=True)
    spec = mujoco.MjSpec.from_file(str(TULIP.with_name("tulip.xml")))
    for body in spec.bodies[1:]:
        body.pos, body.ipos = factor * body.pos, factor * body.ipos
        body.mass, body.inertia = factor**3 * body.mass, factor**5 * body.inertia
    for geom in spec.geoms:
        geom.pos, geom.size, geom.fromto = factor * geom.pos, factor * geom.size, factor * geom.fromto
    for joint in spec.joints:
        joint.armature, joint.frictionloss = factor**4 * joint.armature, factor**4 * joint.frictionloss
        joint.damping = factor**4 * np.asarray(joint.damping)
    for motor in spec.actuators:
        motor.ctrlrange, motor.forcerange = factor**4 * motor.ctrlrange, factor**4 * motor.forcerange
    for key in spec.keys:
        qpos = np.array(key.qpos)
        qpos[:3] *= factor
        key.qpos = qpos
    spec.compile()
    (folder / "robot.xml").write_text(spec.to_xml())
    table = dict(load_robot().settings["planning"])
    table |= {key: (factor * np.array(table[key])).tolist() for key in LENGTHS}
    table["least_cell_load"] *= factor**3
    lines = "".join(f"{key} = {value}\n" for key, value in table.items())
    (folder / "robot.toml").write_text(
        'name = "scaled"\nmodel = "robot.xml"\nstance_foot = "right_foot"\nswing_foot = "left_foot"\n'
        f"[planning]\n{lines}{planning}"
    )
    return load_robot(folder / "robot.toml")
