"""Geometry of held postures: poses of links, joints and soles from the joint angles alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tulip_testbed.identification.kinematics import (
    Tree,
    alike_in_turns,
    frame_positions,
    joint_axes,
    joint_pivots,
    link_rotations,
    moved_frames,
    place_on_feet,
    seen_from,
)
from tulip_testbed.identification.nominal import Nominal


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
        return replace(self, tree=tree, like=(self.like or self) if alike_in_turns(tree, self.tree) else None)

    @property
    def base(self) -> int:
        """Return the frame number of the stance foot."""
        return self.nominal.parameters.base

    @cached_property
    def rotations(self) -> np.ndarray:
        """Compute the rotations of all frames, (m, n_frames, 3, 3)."""
        if self.like is not None:
            return self.like.rotations
        rotations = link_rotations(self.tree, self.base, self.joint_angles)
        return seen_from(self.nominal.swing_frame, rotations, self.on_swing_foot)

    @property
    def on_swing_foot(self) -> np.ndarray:
        """Return which postures stand on the swing foot alone, (m,) bool."""
        return self.nominal.parameters.on_swing_foot(self.support)

    @cached_property
    def frames(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (m, n_frames, 3, 3) and compute origins (m, n_frames, 3) [m] of all frames."""
        stance, swing = -self.nominal.points
        origins = frame_positions(self.tree, self.base, self.rotations, stance)
        place_on_feet(origins, self.nominal.swing_frame, swing, self.on_swing_foot)
        return self.rotations, origins

    @cached_property
    def axes(self) -> np.ndarray:
        """Compute the axes of all joints, (m, n_joints, 3), see `joint_axes`."""
        return joint_axes(self.tree, self.base, self.frames[0])

    @cached_property
    def pivots(self) -> np.ndarray:
        """Compute a point on the axis of each joint, (m, n_joints, 3) [m]."""
        return joint_pivots(self.tree, self.base, *self.frames)

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
        return moved_frames(self.tree, self.base)

    @cached_property
    def center(self) -> np.ndarray:
        """Compute the centre of mass (eq. 1), (m, 3) [m]."""
        return self._first_moments.sum(axis=1) / self.standard[:, 0].sum()

    @cached_property
    def _first_moments(self) -> np.ndarray:
        """Compute mass times centre of mass of every link, (m, n_links, 3) [kg m]."""
        rotations, positions = self.frames
        frames = np.array(self.tree.frame_of_link)
        own = (rotations[:, frames] @ self.standard[:, 1:, None])[..., 0]
        return self.standard[:, 0, None] * positions[:, frames] + own

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

    @cached_property
    def regressor(self) -> np.ndarray:
        """Compute the regressor of the base parameters (eq. 6), (m, 2, p) [-]."""
        if self.like is not None:
            return self.like.regressor
        return self.nominal.parameters.regressor(self.joint_angles, self.support, self._nominal_rotations)

    @property
    def slope(self) -> np.ndarray:
        """Differentiate the regressor with respect to the joint angles, (m, 2, n_joints, p) [1/rad].

        It is large and not kept.
        """
        return self.nominal.parameters.slope(self.joint_angles, self.support, self._nominal_rotations)

    def slope_along(self, theta: np.ndarray) -> np.ndarray:
        """Differentiate the regressor times theta by the joint angles, (m, 2, n_joints) [m/rad].

        Args:
            theta: base parameters, (p,) [m].
        """
        parameters = self.nominal.parameters
        return parameters.slope_along(theta, self.joint_angles, self.support, self._nominal_rotations)

    @property
    def _nominal_rotations(self) -> np.ndarray | None:
        return self.rotations if alike_in_turns(self.tree, self.nominal.parameters.tree) else None
