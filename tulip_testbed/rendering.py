"""Pictures of the robot on its plates by MuJoCo (as the paper's Fig. 3), drawn by a process of its own.

The command line runs without OpenGL (`tulip_testbed.cli.entry`), and a broken driver may end a process; so a
child with EGL or else OSMesa draws. It reads a request (JSON) and writes the images (npy).
"""

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.random_robots import half_edges
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under

PORTRAIT = (480, 640)  # pixels
PLATFORMS = ("egl", "osmesa")
MOST_WAIT = 600  # s
SIDE, ABOVE = 145.0, -14.0  # deg, where the camera stands
SHOWN_GROUP = 2  # geometry of higher groups is not drawn
EDGE = 1.03  # of the least distance: nothing touches the edge
DOT = 0.01  # m: geoms within a smaller radius, as the corners of a sole, do not show a link
BARE_COLOUR = (150, 156, 166)
FRAME, MIDDLE = 1.7, 0.5  # of the robot's height: the camera's distance, and what it looks at


def rendered(
    robot: Robot,
    joint_angles: np.ndarray,
    support: np.ndarray,
    plate_poses: np.ndarray,
    width: int,
    height: int,
) -> np.ndarray:
    """Draw postures, (m, n_joints) [rad], on their boards, (m, 2, 3): (m, height, width, 3) of 8 bits.

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


def standing_picture(robot: Robot) -> bytes:
    """Draw the keyframe `stand` on the plates as a PNG; InputError: nothing draws here."""
    angles = robot.model.key("stand").qpos[7:][None]
    pose = nominal_robot(robot).swing_sole(angles)[:, [0, 1, 5]]
    boards = boards_under(preset_rig("ideal", robot), np.stack([np.zeros_like(pose), pose], axis=1))
    image = rendered(robot, angles, np.array(["double"]), boards, *PORTRAIT)[0]
    out = io.BytesIO()
    Image.fromarray(image).save(out, "png")
    return out.getvalue()


def draw(
    robot: Robot, joint_angles: np.ndarray, feet: list[int], plate_poses: np.ndarray, width: int, height: int
) -> np.ndarray:
    """As `rendered`, in this process, whose MUJOCO_GL says how; `feet` carry the base frame."""
    import mujoco

    from tulip_testbed.sim.dynamics.stand import Stand

    rig = replace(preset_rig("ideal", robot), edit=partial(_visible, robot.model))
    images = np.empty((len(joint_angles), height, width, 3), dtype=np.uint8)
    places, where = np.unique(plate_poses.reshape(len(plate_poses), -1), axis=0, return_inverse=True)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = SIDE, ABOVE
    near = 0.0
    for place, poses in enumerate(places.reshape(-1, 2, 3)):
        stand = Stand(rig, poses)
        stand.model.vis.global_.offwidth, stand.model.vis.global_.offheight = width, height
        # One view for all, so that sizes compare: of the robot with all joints at zero.
        straight = np.zeros(joint_angles.shape[1])
        stand.reset(straight, stand.chain.base_pose(straight))
        mujoco.mj_forward(stand.model, stand.data)
        top = float(stand.data.geom_xpos[:, 2].max())
        camera.lookat[:] = [0.0, plate_poses[:, :, 1].mean(), MIDDLE * top]
        if not place:  # raised arms may reach beyond it
            corners = []
            for angles, foot in zip(joint_angles, feet, strict=True):
                stand.reset(angles, stand.chain.base_pose(angles, foot))
                mujoco.mj_forward(stand.model, stand.data)
                corners.append(_corners(stand, robot))
            near = least_distance(
                np.concatenate(corners), camera.lookat, stand.model.vis.global_.fovy, width / height
            )
        camera.distance = max(FRAME * top, near)
        with mujoco.Renderer(stand.model, height, width) as renderer:
            for row in np.flatnonzero(where == place):
                stand.reset(joint_angles[row], stand.chain.base_pose(joint_angles[row], feet[row]))
                mujoco.mj_forward(stand.model, stand.data)
                renderer.update_scene(stand.data, camera)
                images[row] = renderer.render()
    return images


def _corners(stand: Any, robot: Robot) -> np.ndarray:
    """Return the corners of the boxes around the robot's geometry where it stands, (n, 3) [m]."""
    model, data = stand.model, stand.data
    root = model.body_rootid[model.body(robot.model.body(1).name).id]
    shown = np.flatnonzero((model.body_rootid[model.geom_bodyid] == root) & (model.geom_group <= SHOWN_GROUP))
    signs = np.array(list(product((-1, 1), repeat=3)))
    local = model.geom_aabb[shown, None, :3] + signs * model.geom_aabb[shown, None, 3:]
    turned = np.einsum("gij,gcj->gci", data.geom_xmat[shown].reshape(-1, 3, 3), local)
    return (data.geom_xpos[shown, None] + turned).reshape(-1, 3)


def least_distance(points: np.ndarray, target: np.ndarray, fovy: float, ratio: float) -> float:
    """Compute how far from its target the camera must stand to have all points in the picture [m].

    The field of view [deg] is that from its lower to its upper edge, the ratio its width over its height.
    """
    side, up = np.radians(SIDE), np.radians(ABOVE)
    ahead = np.array([np.cos(up) * np.cos(side), np.cos(up) * np.sin(side), np.sin(up)])
    right = np.array([np.sin(side), -np.cos(side), 0.0])
    half = np.tan(np.radians(fovy) / 2)
    seen = points - target
    across, above = np.abs(seen @ right) / (ratio * half), np.abs(seen @ np.cross(right, ahead)) / half
    return EDGE * float((np.maximum(across, above) - seen @ ahead).max())


def _visible(model: Any, spec: Any) -> None:
    """Light the scene, and give links that no geometry shows the boxes of their inertia."""
    import mujoco

    lit(spec)
    for body, half in enumerate(half_edges(model), start=1):
        shown = (model.geom_bodyid == body) & (model.geom_group <= SHOWN_GROUP) & (model.geom_rbound > DOT)
        if half.all() and not shown.any():
            spec.body(model.body(body).name).add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=half,
                pos=model.body_ipos[body],
                quat=model.body_iquat[body],
                rgba=[*np.divide(BARE_COLOUR, 255), 1.0],
                mass=0,
                contype=0,
                conaffinity=0,
            )


def lit(spec: Any) -> None:
    """Light, a pale sky and a pale floor for a scene that brings none."""
    import mujoco

    if not spec.lights:
        for floor in (geom for geom in spec.worldbody.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE):
            floor.rgba = [0.86, 0.88, 0.9, 1.0]
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
    """The child: a request on stdin, images on stdout."""
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
