"""The nominal robot: its feet, mass, centre of mass and link boxes, and the geometry of its postures."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import mujoco
import numpy as np

from tulip_testbed.identification import kinematics
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, standard_parameters
from tulip_testbed.identification.kinematics import Tree
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

    @property
    def sole_centers(self) -> np.ndarray:
        """Return the centre of each sole from its sole point, in the foot's axes, (2, 2) [m]."""
        return self.soles.mean(axis=1) - self.points[:, :2]

    @property
    def sole_rises(self) -> np.ndarray:
        """Return the rise of each sole point by roll and pitch about its sole's centre, (2, 2) [m/rad]."""
        x, y = self.sole_centers.T
        return np.column_stack([-y, x])

    def center_of_mass(self, joint_angles: np.ndarray, support: np.ndarray | None = None) -> np.ndarray:
        """Compute the projection of the centre of mass in the base frame, (m, 2) [m].

        Args:
            joint_angles: (m, n_joints) [rad].
            support: of every row, (m,) of text; a row on the swing foot alone has that foot's frame as base
                frame. None: there is no such row.
        """
        center = self.parameters.regressor(joint_angles, support) @ self.value
        return center if support is None else center + self.geometry(joint_angles, support).stance_sole[:, :2]

    def geometry(self, joint_angles: np.ndarray, support: np.ndarray | None = None) -> PostureGeometry:
        """Return the geometry of postures; arguments as `center_of_mass`."""
        support = np.full(len(joint_angles), "double") if support is None else support
        standard = standard_parameters(self.robot.model)
        return PostureGeometry(self, self.parameters.tree, joint_angles, support, standard)

    def other_sole(self, joint_angles: np.ndarray, support: np.ndarray) -> np.ndarray:
        """Compute x, y, yaw of the other sole, (m, 3) [m, m, rad]; arguments as `center_of_mass`."""
        geometry = self.geometry(joint_angles, support)
        foot = geometry.rotations[:, geometry.base]
        there = np.column_stack([geometry.stance_sole[:, :2], np.arctan2(foot[:, 1, 0], foot[:, 0, 0])])
        pose = self.swing_sole(joint_angles)[:, [0, 1, 5]]
        return np.where(geometry.on_swing_foot[:, None], there, pose)

    def swing_sole(self, joint_angles: np.ndarray) -> np.ndarray:
        """Compute the swing sole's pose in the base frame: x, y, z, roll, pitch, yaw, (m, 6) [m, rad]."""
        place, foot = self.geometry(joint_angles).swing_sole
        return np.column_stack([place, kinematics.roll_pitch_yaw(foot)])

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


@dataclass(frozen=True)
class PostureGeometry:
    """Geometry of m postures in the frame of the foot that carries, with flat soles.

    Each quantity is computed once, when it is first asked for.

    Attributes:
        nominal: nominal robot.
        tree: kinematics with the assumed lengths.
        joint_angles: joint angles, (m, n_joints) [rad].
        support: of every posture, (m,) of text. One on the swing foot alone is seen from that foot.
        standard: nominal standard parameters of the links (eq. 5), (n_links, 4) [kg, kg m].
        like: the same postures of links with other lengths; None: not known.
    """

    nominal: Nominal
    tree: Tree
    joint_angles: np.ndarray
    support: np.ndarray
    standard: np.ndarray
    like: PostureGeometry | None = None

    def with_lengths(self, tree: Tree) -> PostureGeometry:
        """Return the geometry with another tree; lengths leave rotations and regressor as they are."""
        alike = kinematics.alike_in_turns(tree, self.tree)
        return replace(self, tree=tree, like=(self.like or self) if alike else None)

    @property
    def base(self) -> int:
        """Return the frame number of the stance foot."""
        return self.nominal.parameters.base

    @cached_property
    def rotations(self) -> np.ndarray:
        """Compute the rotations of all frames, (m, n_frames, 3, 3)."""
        if self.like is not None:
            return self.like.rotations
        rotations = kinematics.link_rotations(self.tree, self.base, self.joint_angles)
        return kinematics.seen_from(self.nominal.swing_frame, rotations, self.on_swing_foot)

    @property
    def on_swing_foot(self) -> np.ndarray:
        """Return which postures stand on the swing foot alone, (m,) bool."""
        return self.nominal.parameters.on_swing_foot(self.support)

    @cached_property
    def frames(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (m, n_frames, 3, 3) and compute origins (m, n_frames, 3) [m] of all frames."""
        if self.like is not None:
            rotations, origins = self.like.frames
            shift = kinematics.frame_shifts(self.tree, self.like.tree, self.base, rotations)
            shift[self.on_swing_foot] -= shift[self.on_swing_foot, None, self.nominal.swing_frame]
            return rotations, origins + shift
        stance, swing = -self.nominal.points
        origins = kinematics.frame_positions(self.tree, self.base, self.rotations, stance)
        rows = self.on_swing_foot  # where the swing foot's link has its origin in its own base frame
        origins[rows] += swing - origins[rows, None, self.nominal.swing_frame]
        return self.rotations, origins

    @cached_property
    def axes(self) -> np.ndarray:
        """Compute the axes of all joints, (m, n_joints, 3), see `joint_axes`."""
        return kinematics.joint_axes(self.tree, self.base, self.frames[0])

    @cached_property
    def pivots(self) -> np.ndarray:
        """Compute a point on the axis of each joint, (m, n_joints, 3) [m]."""
        return kinematics.joint_pivots(self.tree, self.base, *self.frames)

    @cached_property
    def stance_sole(self) -> np.ndarray:
        """Compute the place of the stance foot's sole point, (m, 3) [m]; zero unless it is in the air."""
        rotations, positions = self.frames
        turned = (rotations[:, self.base] @ self.nominal.points[0, :, None])[..., 0]
        return positions[:, self.base] + turned

    @property
    def stance_sole_slope(self) -> np.ndarray:
        """Differentiate `stance_sole` by the joint angles, (m, 3, n_joints) [m]."""
        if not self.on_swing_foot.any():
            return np.zeros((len(self.joint_angles), 3, self.axes.shape[1]))
        moved = self.nominal.parameters.moved(self.support)[:, :, self.base, None]
        return np.cross(moved * self.axes, self.stance_sole[:, None] - self.pivots).mT

    @cached_property
    def moved(self) -> np.ndarray:
        """Return which frames each joint turns against the stance foot, (n_joints, n_frames) bool."""
        return kinematics.moved_frames(self.tree, self.base)

    @cached_property
    def center(self) -> np.ndarray:
        """Compute the centre of mass (eq. 1), (m, 3) [m]."""
        return self._first_moments.sum(axis=1) / self.standard[:, 0].sum()

    @cached_property
    def _first_moments(self) -> np.ndarray:
        """Compute mass times centre of mass of every link, (m, n_links, 3) [kg m]."""
        positions = self.frames[1][:, np.array(self.tree.frame_of_link)]
        return self.standard[:, 0, None] * positions + self._own_moments

    @cached_property
    def _own_moments(self) -> np.ndarray:
        """Compute the part about the origin of every link's frame, (m, n_links, 3) [kg m]."""
        if self.like is not None:
            return self.like._own_moments
        turns = self.rotations[:, np.array(self.tree.frame_of_link)]
        return np.einsum("mlij,lj->mli", turns, self.standard[:, 1:])

    @cached_property
    def mass_moments(self) -> np.ndarray:
        """Compute the moment of the links beyond each joint about it, over gravity, (m, n_joints) [kg m]."""
        carried = self.moved[:, np.array(self.tree.frame_of_link)].astype(float)
        heavy = carried @ self.standard[:, 0]
        moment = carried @ self._first_moments - heavy[:, None] * self.pivots
        return -moment[..., 1] * self.axes[..., 0] + moment[..., 0] * self.axes[..., 1]

    @cached_property
    def swing_sole(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the place of the swing sole point, (m, 3) [m], and the foot's rotation, (m, 3, 3)."""
        rotations, positions = self.frames
        turn = rotations[:, self.nominal.swing_frame]
        return positions[:, self.nominal.swing_frame] + turn @ self.nominal.points[1], turn

    @property
    def soles(self) -> np.ndarray:
        """Return the corners of the right and the left sole from above, (m, 2, 4, 2) [m]."""
        (rotations, positions), feet = self.frames, (self.base, self.nominal.swing_frame)
        soles = []
        for frame, corners, point in zip(feet, self.nominal.soles, self.nominal.points, strict=True):
            local = np.column_stack([corners, np.full(len(corners), point[2])])
            placed = positions[:, frame, None] + local @ rotations[:, frame].mT
            soles.append(placed[..., :2])
        return np.stack(soles, axis=1)

    @cached_property
    def regressor(self) -> np.ndarray:
        """Compute the regressor of the base parameters (eq. 6), (m, 2, p) [-]."""
        if self.like is not None:
            return self.like.regressor
        return self.nominal.parameters.regressor(self.joint_angles, self.support, self._nominal_rotations)

    @property
    def slope(self) -> np.ndarray:
        """Differentiate the regressor by the angles, (m, 2, n_joints, p) [1/rad]: large, and not kept."""
        return self.nominal.parameters.slope(self.joint_angles, self.support, self._nominal_rotations)

    def slope_along(self, theta: np.ndarray) -> np.ndarray:
        """Differentiate the regressor times theta, (p,) [m], by joint angles, (m, 2, n_joints) [m/rad]."""
        parameters = self.nominal.parameters
        return parameters.slope_along(theta, self.joint_angles, self.support, self._nominal_rotations)

    @property
    def _nominal_rotations(self) -> np.ndarray | None:
        return self.rotations if kinematics.alike_in_turns(self.tree, self.nominal.parameters.tree) else None
