"""A box around each link in its own frame, from the robot's file."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np

SIDES = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def link_boxes(model: mujoco.MjModel) -> np.ndarray:
    """Lower and upper corner of every link's box, in MJCF order, (n_links, 2, 3) [m].

    A box holds the link's geoms and its own centre of mass; without geoms it is the box of uniform
    density that has the link's inertia.
    """
    boxes = []
    for body in range(1, model.nbody):
        points = [model.body_ipos[body][None]]
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        for geom in range(first, first + count):
            corners = model.geom_aabb[geom, :3] + SIDES * model.geom_aabb[geom, 3:]
            points.append(corners @ _rotation(model.geom_quat[geom]).T + model.geom_pos[geom])
        if not count and model.body_mass[body] > 0:
            inertia = model.body_inertia[body]
            half = np.sqrt(1.5 * np.maximum(inertia.sum() - 2 * inertia, 0.0) / model.body_mass[body])
            points.append(SIDES * half @ _rotation(model.body_iquat[body]).T + model.body_ipos[body])
        every = np.vstack(points)
        boxes.append([every.min(axis=0), every.max(axis=0)])
    return np.array(boxes)


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
