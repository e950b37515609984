"""Render the robot on its plates with the forces of the cells and the centre of pressure, by a child process.

The parent has no OpenGL, as the command line has none; the child draws with OSMesa. It reads arrays (npz) and
writes the images (npy).
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tulip_testbed.colours import ESTIMATE, MEASURED, TRUTH, rgb
from tulip_testbed.sim.robot import load_robot

AZIMUTH, ELEVATION, DISTANCE = 150.0, -27.0, 1.95  # of the camera [deg, deg, m]
LOOKED_AT = (0.0, 0.07, 0.50)  # m
ARROW = 0.45 / 50.0  # m/N
LEAST_ARROW = 1.0  # N: less is not drawn
LUMINANCE = np.array([0.3, 0.59, 0.11])
THICK, MARK, HEIGHT = 0.011, 0.026, 0.003  # m


@dataclass(frozen=True, eq=False)
class Scenes:
    """Content of each of k images; everything in the base frame.

    Attributes:
        angles: joint angles, (k, n_joints) [rad].
        plates: poses of the boards, (k, 2, 3) [m, m, rad].
        cells: places of the cells, (k, 8, 2) [m]. forces: on them, (k, 8) [N].
        pressure: centre of pressure, (k, 2) [m]. center: centre of mass, (k, 3) [m].
        size: width and height of an image [pixels], (2,).
    """

    angles: np.ndarray
    plates: np.ndarray
    cells: np.ndarray
    forces: np.ndarray
    pressure: np.ndarray
    center: np.ndarray
    size: np.ndarray


def rendered_scenes(scenes: Scenes) -> np.ndarray:
    """Draw TULip in a child process with OSMesa, (k, height, width, 3), 8 bits a channel.

    Raises:
        subprocess.CalledProcessError: the child failed, most often because libosmesa6 is missing.
    """
    request = io.BytesIO()
    np.savez(request, allow_pickle=False, **asdict(scenes))
    environment = os.environ | {"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "osmesa"}
    done = subprocess.run(
        [sys.executable, "-m", "studies.teaching.renderer"],
        input=request.getvalue(),
        stdout=subprocess.PIPE,
        env=environment,
        check=True,
    )
    return np.load(io.BytesIO(done.stdout), allow_pickle=False)


def draw(scenes: Scenes) -> np.ndarray:
    """As `rendered_scenes`, in this process."""
    import mujoco

    from tulip_testbed.rendering import lit
    from tulip_testbed.sim.dynamics.stand import Stand
    from tulip_testbed.sim.rig import preset_rig

    rig = replace(preset_rig("ideal", load_robot()), edit=lit)
    width, height = scenes.size.tolist()
    images = np.empty((len(scenes.angles), height, width, 3), np.uint8)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = AZIMUTH, ELEVATION, DISTANCE
    camera.lookat[:] = LOOKED_AT
    places, where = np.unique(scenes.plates.round(6).reshape(len(images), -1), axis=0, return_inverse=True)
    for place, poses in enumerate(places.reshape(-1, 2, 3)):
        stand = Stand(rig, poses)
        # Grey, so that colours mean forces and centres alone. Only the plates have no material.
        colours = stand.model.mat_rgba
        colours[:, :3] = 0.3 + 0.7 * (colours[:, :3] @ LUMINANCE)[:, None]
        stand.model.vis.global_.offwidth, stand.model.vis.global_.offheight = width, height
        with mujoco.Renderer(stand.model, height, width) as renderer:
            for row in np.flatnonzero(where.ravel() == place):
                angles = scenes.angles[row]
                stand.reset(angles, stand.chain.base_pose(angles))
                mujoco.mj_forward(stand.model, stand.data)
                renderer.update_scene(stand.data, camera)
                for cell, force in zip(scenes.cells[row], scenes.forces[row], strict=True):
                    if force > LEAST_ARROW:
                        foot = np.append(cell, HEIGHT)
                        tip = foot + np.array([0.0, 0.0, ARROW * force])
                        _link(renderer.scene, mujoco.mjtGeom.mjGEOM_ARROW, THICK, foot, tip, ESTIMATE)
                point, center = np.append(scenes.pressure[row], HEIGHT), scenes.center[row]
                _link(renderer.scene, mujoco.mjtGeom.mjGEOM_CAPSULE, 0.006, point, center, MEASURED)
                _ball(renderer.scene, MARK, point, MEASURED)
                _ball(renderer.scene, MARK, center, TRUTH)
                images[row] = renderer.render()
    return images


def _link(scene: Any, kind: int, width: float, start: np.ndarray, end: np.ndarray, colour: str) -> None:
    import mujoco

    geom = _new(scene, kind, colour, np.zeros(3), np.zeros(3))
    mujoco.mjv_connector(geom, kind, width, start, end)


def _ball(scene: Any, radius: float, place: np.ndarray, colour: str) -> None:
    import mujoco

    _new(scene, mujoco.mjtGeom.mjGEOM_SPHERE, colour, np.full(3, radius), place)


def _new(scene: Any, kind: int, colour: str, size: np.ndarray, place: np.ndarray) -> Any:
    import mujoco

    geom = scene.geoms[scene.ngeom]
    rgba = np.append(np.array(rgb(colour)) / 255, 1.0).astype(np.float32)
    mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).ravel(), rgba)
    geom.emission = 0.5
    scene.ngeom += 1
    return geom


def main() -> None:
    """The child: a request on stdin, images on stdout."""
    with np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False) as request:
        images = draw(Scenes(**request))
    np.save(sys.stdout.buffer, images, allow_pickle=False)


if __name__ == "__main__":
    main()
