"""Pictures of the robot on its plates by MuJoCo, drawn by a process of its own.

The command line runs without OpenGL (`experiments.entry`), and a broken driver may end a process; so a
child with EGL or else OSMesa draws. It reads a request (JSON) and writes the images (npy).
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from sim.errors import InputError, shortened
from sim.measurements import PosturePlan
from sim.model import Robot

PLATFORMS = ("egl", "osmesa")
MOST_WAIT = 600  # s
SIDE, ABOVE = 145.0, -14.0  # deg, where the camera stands
FRAME, MIDDLE = 1.7, 0.5  # of the robot's height: the camera's distance, and what it looks at


def rendered(robot: Robot, plan: PosturePlan, width: int, height: int) -> np.ndarray:
    """Every posture of a plan on its boards, (m, height, width, 3), 8 bits a channel.

    Raises:
        InputError: neither EGL nor OSMesa draws.
    """
    request = {
        "robot": str(robot.path),
        "angles": plan.joint_angles.tolist(),
        "swing": plan.swing_pose.tolist(),
        "size": [width, height],
    }
    said = ""
    for platform in PLATFORMS:
        environment = os.environ | {"MUJOCO_GL": platform, "PYOPENGL_PLATFORM": platform}
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
        try:
            done = subprocess.run(
                [sys.executable, "-m", "experiments.rendering"],
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


def draw(robot: Robot, angles: np.ndarray, swing: np.ndarray, width: int, height: int) -> np.ndarray:
    """As `rendered`, in this process.

    Args:
        angles: (m, n_joints) [rad]. swing: poses of the swing foot, (m, 3) [m, m, rad].
    """
    import mujoco

    from sim.laboratory import boards_under
    from sim.rig import preset_rig
    from sim.stand import Stand

    rig = preset_rig("ideal", robot)
    images = np.empty((len(angles), height, width, 3), dtype=np.uint8)
    boards = boards_under(rig, swing)
    _, where = np.unique(swing, axis=0, return_inverse=True)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = SIDE, ABOVE
    for place in np.unique(where):
        rows = np.flatnonzero(where == place)
        stand = Stand(rig, boards[rows[0]])
        stand.model.vis.global_.offwidth, stand.model.vis.global_.offheight = width, height
        # One view for all, so that sizes compare: of the robot with all joints at zero.
        straight = np.zeros(angles.shape[1])
        stand.reset(straight, stand.chain.base_pose(straight))
        mujoco.mj_forward(stand.model, stand.data)
        top = float(stand.data.geom_xpos[:, 2].max())
        camera.lookat[:] = [0.0, boards[:, :, 1].mean(), MIDDLE * top]
        camera.distance = FRAME * top
        with mujoco.Renderer(stand.model, height, width) as renderer:
            for row in rows:
                stand.reset(angles[row], stand.chain.base_pose(angles[row]))
                mujoco.mj_forward(stand.model, stand.data)
                renderer.update_scene(stand.data, camera)
                images[row] = renderer.render()
    return images


def main() -> None:
    """The child: a request on stdin, images on stdout."""
    from sim.model import load_robot

    request = json.load(sys.stdin)
    images = draw(
        load_robot(Path(request["robot"])),
        np.array(request["angles"]),
        np.array(request["swing"]),
        *request["size"],
    )
    np.save(sys.stdout.buffer, images, allow_pickle=False)


if __name__ == "__main__":
    main()
