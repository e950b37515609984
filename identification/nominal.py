"""The nominal robot: its feet, mass, centre of mass and link boxes, from its files."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, standard_parameters
from tulip_testbed.identification.kinematics import (
    frame_positions,
    link_rotations,
    place_on_feet,
    roll_pitch_yaw,
)
from tulip_testbed.sim.robot import Robot, rotation_matrices, sole_corners, sole_point

STEP = 1e-5  # rad, of central differences


@dataclass(frozen=True)
class Nominal:
    """Properties of the robot by its own files, before anything is identified.

    Attributes:
        parameters: base parameters in double support.
        value: their nominal values, (p,) [m].
        mass: total mass [kg].
        soles: sole corners of the stance and the swing foot in their feet's frames, (2, 4, 2) [m].
        points: sole point below each ankle in its foot's frame, (2, 3) [m].
        swing_frame: frame number of the swing foot.
    """

    robot: Robot
    parameters: BaseParameters
    value: np.ndarray
    mass: float
    soles: np.ndarray
    points: np.ndarray
    swing_frame: int

    def center_of_mass(self, joint_angles: np.ndarray, support: np.ndarray | None = None) -> np.ndarray:
        """Compute the projection of the centre of mass in the base frame, (m, 2) [m].

        Args:
            joint_angles: (m, n_joints) [rad].
            support: of every row, (m,) of text; a row on the swing foot alone has that foot's frame as base
                frame. None: there is no such row.
        """
        center = self.parameters.regressor(joint_angles, support) @ self.value
        return center if support is None else center + self.stance_sole(joint_angles, support)[:, :2]

    def stance_sole(self, joint_angles: np.ndarray, support: np.ndarray) -> np.ndarray:
        """Compute the stance foot's sole point in the base frame, (m, 3) [m]; zero unless it is in the air.

        Args:
            joint_angles, support: see `center_of_mass`.
        """
        parameters = self.parameters
        rotations = parameters.rotations(joint_angles, support)
        places = frame_positions(parameters.tree, parameters.base, rotations, -self.points[0])
        place_on_feet(places, self.swing_frame, -self.points[1], parameters.on_swing_foot(support))
        return places[:, parameters.base] + rotations[:, parameters.base] @ self.points[0]

    def other_sole(self, joint_angles: np.ndarray, support: np.ndarray) -> np.ndarray:
        """Compute the pose of the sole that is not the base frame's: x, y, yaw, (m, 3) [m, m, rad].

        Args:
            joint_angles, support: see `center_of_mass`.
        """
        pose, rows = self.swing_sole(joint_angles)[:, [0, 1, 5]], self.parameters.on_swing_foot(support)
        foot = self.parameters.rotations(joint_angles, support)[:, self.parameters.base]
        yaw = np.arctan2(foot[:, 1, 0], foot[:, 0, 0])
        there = np.column_stack([self.stance_sole(joint_angles, support)[:, :2], yaw])
        return np.where(rows[:, None], there, pose)

    def swing_sole(self, joint_angles: np.ndarray) -> np.ndarray:
        """Compute the swing sole's pose in the base frame: x, y, z, roll, pitch, yaw, (m, 6) [m, rad]."""
        tree, base = self.parameters.tree, self.parameters.base
        rotations = link_rotations(tree, base, joint_angles)
        positions = frame_positions(tree, base, rotations, -self.points[0])
        foot = rotations[:, self.swing_frame]
        place = positions[:, self.swing_frame] + foot @ self.points[1]
        return np.column_stack([place, roll_pitch_yaw(foot)])

    def soles_in_base(self, joint_angles: np.ndarray) -> np.ndarray:
        """Compute the corners of both soles in the base frame, stance foot first, (m, 2, 4, 2) [m]."""
        pose = self.swing_sole(joint_angles)
        c, s = np.cos(pose[:, 5]), np.sin(pose[:, 5])
        turn = np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
        swing = self.soles[1] @ turn.transpose(0, 2, 1) + pose[:, None, :2]
        stance = np.broadcast_to(self.soles[0], swing.shape)
        return np.stack([stance, swing], axis=1)


@lru_cache(maxsize=32)
def nominal_robot(robot: Robot, support: str = "double") -> Nominal:
    """Read the nominal robot from its files.

    Args:
        support: see `base_parameters`.

    Raises:
        InputError: the model is broken, or its feet or joints are not as required.
    """
    model = robot.model
    parameters = base_parameters(robot, support=support)
    standard = standard_parameters(model)
    return Nominal(
        robot=robot,
        parameters=parameters,
        value=parameters.values(standard),
        mass=float(standard[:, 0].sum()),
        soles=np.array([sole_corners(model, foot)[:, :2] for foot in robot.feet]),
        points=np.array([sole_point(model, foot) for foot in robot.feet]),
        swing_frame=parameters.tree.frame(robot.swing_foot),
    )


def jacobian(function: Callable[[np.ndarray], np.ndarray], joint_angles: np.ndarray) -> np.ndarray:
    """Differentiate a function (m, n) -> (m, k) by the joint angles, (m, k, n), by central differences."""
    steps = STEP * np.eye(joint_angles.shape[1])
    columns = [(function(joint_angles + step) - function(joint_angles - step)) / (2 * STEP) for step in steps]
    return np.stack(columns, axis=-1)


SIDES = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def link_boxes(model: mujoco.MjModel) -> np.ndarray:
    """Return lower and upper corner of every link's box in its own frame, (n_links, 2, 3) [m].

    A box encloses the link's geoms and its centre of mass; without geoms it is the box of uniform density
    with the link's inertia. Links are in MJCF order.
    """
    every = [outline(model, body) for body in range(1, model.nbody)]
    return np.array([[points.min(axis=0), points.max(axis=0)] for points in every])


def outline(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Return the corners of a body's geoms and its centre of mass in its frame, (k, 3) [m].

    Without geoms they are the corners of the box of uniform density with the body's inertia.
    """
    points = [model.body_ipos[body][None]]
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    geoms = range(first, first + count)
    for geom, turn in zip(geoms, rotation_matrices(model.geom_quat[first : first + count]), strict=True):
        corners = model.geom_aabb[geom, :3] + SIDES * model.geom_aabb[geom, 3:]
        points.append(corners @ turn.T + model.geom_pos[geom])
    if not count and model.body_mass[body] > 0:
        inertia = model.body_inertia[body]
        half = np.sqrt(1.5 * np.maximum(inertia.sum() - 2 * inertia, 0.0) / model.body_mass[body])
        (turn,) = rotation_matrices(model.body_iquat[[body]])
        points.append(SIDES * half @ turn.T + model.body_ipos[body])
    return np.vstack(points)
