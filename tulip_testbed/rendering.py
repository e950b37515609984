"""Pictures of the robot on its plates by MuJoCo (as the paper's Fig. 3), drawn by a process of its own.

The command line runs without OpenGL (`tulip_testbed.cli.entry`), and a broken driver may end a process; so a
child with EGL or else OSMesa draws. It reads a request (JSON) and writes the images (npy).
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.sim.errors import InputError, shortened
from tulip_testbed.sim.measurements.data import base_foot
from tulip_testbed.sim.robot import Robot

PLATFORMS = ("egl", "osmesa")
MOST_WAIT = 600  # s
SIDE, ABOVE = 145.0, -14.0  # deg, where the camera stands
FRAME, MIDDLE = 1.7, 0.5  # of the robot's height: the camera's distance, and what it looks at


def rendered(
    robot: Robot,
    joint_angles: np.ndarray,
    support: np.ndarray,
    plate_poses: np.ndarray,
    width: int,
    height: int,
) -> np.ndarray:
    """Render postures on their boards, (m, height, width, 3), 8 bits a channel.

    Args:
        joint_angles: (m, n_joints) [rad]. support: "double", "right" or "left", (m,).
        plate_poses: (m, 2, 3) [m, m, rad].

    Raises:
        InputError: neither EGL nor OSMesa draws; names the packages to install.
    """
    request = {
        "robot": str(robot.path),
        "angles": joint_angles.tolist(),
        "feet": base_foot(support).tolist(),
        "plates": plate_poses.tolist(),
        "size": [width, height],
    }
    said = ""
    for platform in PLATFORMS:
        environment = os.environ | {"MUJOCO_GL": platform, "PYOPENGL_PLATFORM": platform}
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
        try:
            done = subprocess.run(
                [sys.executable, "-m", "tulip_testbed.rendering"],
                input=json.dumps(request).encode(),
                capture_output=True,
                env=environment,
                timeout=MOST_WAIT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            said = f"no picture within {MOST_WAIT} s"
            continue
        if done.returncode == 0:
            return np.load(io.BytesIO(done.stdout), allow_pickle=False)
        said = done.stderr.decode("utf-8", "replace").strip().rsplit("\n", 1)[-1]
    raise InputError(
        f"rendering: neither EGL nor OSMesa draws ({shortened(said)}); on Debian: apt-get install libegl1 "
        "libgl1-mesa-dri libosmesa6"
    )


def draw(
    robot: Robot,
    joint_angles: np.ndarray,
    feet: list[int],
    plate_poses: np.ndarray,
    width: int,
    height: int,
) -> np.ndarray:
    """Render as `rendered` does, in this process, whose MUJOCO_GL says how; `feet` carry the base frame."""
    import mujoco

    from tulip_testbed.sim.dynamics.stand import Stand
    from tulip_testbed.sim.rig import preset_rig

    rig = replace(preset_rig("ideal", robot), edit=_lit)
    images = np.empty((len(joint_angles), height, width, 3), dtype=np.uint8)
    places, where = np.unique(plate_poses.reshape(len(plate_poses), -1), axis=0, return_inverse=True)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = SIDE, ABOVE
    for place, poses in enumerate(places.reshape(-1, 2, 3)):
        stand = Stand(rig, poses)
        stand.model.vis.global_.offwidth, stand.model.vis.global_.offheight = width, height
        # One view for all, so that sizes compare: of the robot with all joints at zero.
        straight = np.zeros(joint_angles.shape[1])
        stand.reset(straight, stand.chain.base_pose(straight))
        mujoco.mj_forward(stand.model, stand.data)
        top = float(stand.data.geom_xpos[:, 2].max())
        camera.lookat[:] = [0.0, plate_poses[:, :, 1].mean(), MIDDLE * top]
        camera.distance = FRAME * top
        with mujoco.Renderer(stand.model, height, width) as renderer:
            for row in np.flatnonzero(where == place):
                stand.reset(joint_angles[row], stand.chain.base_pose(joint_angles[row], feet[row]))
                mujoco.mj_forward(stand.model, stand.data)
                renderer.update_scene(stand.data, camera)
                images[row] = renderer.render()
    return images


def _lit(spec: Any) -> None:
    """Add light and a pale sky to a scene that brings none."""
    import mujoco

    if not spec.lights:
        spec.worldbody.add_light(
            pos=[0.6, -0.6, 3.0],
            dir=[-0.2, 0.2, -1.0],
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            diffuse=[0.6, 0.6, 0.6],
        )
        spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
        spec.visual.headlight.diffuse = [0.4, 0.4, 0.4]
        spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.95, 0.97, 1.0],
            rgb2=[0.7, 0.78, 0.86],
            width=64,
            height=384,
        )


def main() -> None:
    """Run the child process: a request on stdin, images on stdout."""
    from tulip_testbed.sim.robot import load_robot

    request = json.load(sys.stdin)
    images = draw(
        load_robot(Path(request["robot"]), meshes=True),
        np.array(request["angles"]),
        request["feet"],
        np.array(request["plates"]),
        *request["size"],
    )
    np.save(sys.stdout.buffer, images, allow_pickle=False)


if __name__ == "__main__":
    main()
