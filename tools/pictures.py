"""Draw the README's picture: the robot on its plates in four postures of the shipped plan."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from experiments.scenario import DEFAULT_PLAN
from sim.hold import put_down
from sim.measurements import lay_boards, read_plan
from sim.model import load_model, load_robot, sole_corners
from sim.plates import plate_geometry
from sim.rig import preset_rig
from sim.scene import load_scene
from sim.stand import Stand

ROWS = (2, 26, 58, 121)
SIZE = (420, 560)


def main() -> None:
    robot = load_robot()
    model = load_model(robot)
    plan = read_plan(DEFAULT_PLAN, robot, model)
    size = plate_geometry(load_scene(robot), "right").size
    corners = [sole_corners(model, foot)[:, :2] for foot in robot.feet]
    frames = []
    for row in ROWS:
        x, y, yaw = plan.swing_pose[row]
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        soles = np.array([corners[0], corners[1] @ turn + [x, y]])
        stand = Stand(preset_rig("ideal", robot), lay_boards(soles, size, 0.01))
        put_down(stand, plan.joint_angles[row])
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation, camera.distance = 145, -14, 2.2
        camera.lookat[:] = [0.0, 0.1, 0.52]
        with mujoco.Renderer(stand.model, SIZE[1], SIZE[0]) as renderer:
            renderer.update_scene(stand.data, camera)
            frames.append(renderer.render().copy())
    target = Path(__file__).parent.parent / "docs" / "postures.png"
    Image.fromarray(np.hstack(frames)).quantize(128).save(target, optimize=True)
    print(target)


if __name__ == "__main__":
    main()
