"""Pictures of postures by MuJoCo without a screen, as in the paper's Fig. 3.

MuJoCo chooses its OpenGL when it is imported, so a process of its own draws.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from identification.kinematics import frame_positions, link_rotations
from identification.nominal import nominal_robot
from sim.errors import InputError
from sim.model import Robot, compile_spec, load_robot
from sim.plates import place_plates
from sim.scene import load_scene

BACKENDS = ("osmesa", "egl")
PACKAGE = "libosmesa6"
SIZE = (360, 480)  # pixels
COLOURS = 128  # of a picture, which then takes a third of the space
PATIENCE = 60  # s
AZIMUTH, ELEVATION = 145, -14  # deg
TULIP_HEIGHT, DISTANCE, MIDDLE = 1.25, 2.2, 0.52  # m


def render(robot: Robot, joint_angles: np.ndarray, plate_poses: np.ndarray) -> list[bytes]:
    """One PNG a posture.

    Args:
        joint_angles: (k, n_joints) [rad]. plate_poses: (k, 2, 3) [m, m, rad].

    Raises:
        InputError: there is no OpenGL to draw with; names the package to install.
    """
    with tempfile.TemporaryDirectory() as scratch:
        task = Path(scratch) / "postures.npz"
        np.savez(task, joint_angles=joint_angles, plate_poses=plate_poses)
        command = [sys.executable, "-m", "experiments.report.rendering", str(robot.path), str(task)]
        root = str(Path(__file__).resolve().parents[2])
        for backend in BACKENDS:
            places = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
            environment = os.environ | {"MUJOCO_GL": backend, "PYTHONPATH": places}
            environment.pop("PYOPENGL_PLATFORM", None)
            try:
                drawn = subprocess.run(command, env=environment, capture_output=True, timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                continue
            if drawn.returncode == 0:
                return [(Path(scratch) / f"{row}.png").read_bytes() for row in range(len(joint_angles))]
    raise InputError(
        f"found no OpenGL to draw postures with (tried {' and '.join(BACKENDS)}), expected one: "
        f"`apt-get install {PACKAGE}`"
    )


def draw(robot: Robot, joint_angles: np.ndarray, plate_poses: np.ndarray) -> list[Image.Image]:
    """In this process, whose MUJOCO_GL says how."""
    nominal = nominal_robot(robot)
    tree, base = nominal.parameters.tree, nominal.parameters.base
    rotations = link_rotations(tree, base, joint_angles)
    positions = frame_positions(tree, base, rotations, -nominal.points[0])
    root = tree.frame_of_link[0]
    pictures = []
    for row, poses in enumerate(plate_poses):
        spec = load_scene(robot)
        place_plates(spec, poses)
        _lit(spec)
        model = compile_spec(spec, str(robot.path))
        data = mujoco.MjData(model)
        free = int(model.jnt_qposadr[np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0]])
        x, y, z, w = Rotation.from_matrix(rotations[row, root]).as_quat()
        data.qpos[free : free + 7] = [*positions[row, root], w, x, y, z]
        for joint, angle in zip(tree.joints, joint_angles[row], strict=True):
            data.qpos[model.joint(joint).qposadr[0]] = angle
        mujoco.mj_forward(model, data)
        pictures.append(_picture(model, data))
    return pictures


def _picture(model: mujoco.MjModel, data: mujoco.MjData) -> Image.Image:
    # Planes have no bounding sphere.
    tops = (data.geom_xpos[:, 2] + model.geom_rbound)[model.geom_rbound > 0]
    scale = float(tops.max()) / TULIP_HEIGHT
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = AZIMUTH, ELEVATION, DISTANCE * scale
    camera.lookat[:] = [0.0, 0.1 * scale, MIDDLE * scale]
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        renderer.update_scene(data, camera)
        return Image.fromarray(renderer.render()).quantize(COLOURS)


def _lit(spec: mujoco.MjSpec) -> None:
    """Light and a pale sky for a scene that brings none."""
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


def main(description: str, task: str) -> None:
    with np.load(task) as content:
        pictures = draw(load_robot(Path(description)), content["joint_angles"], content["plate_poses"])
    for row, picture in enumerate(pictures):
        picture.save(Path(task).parent / f"{row}.png", optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
