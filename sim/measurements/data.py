"""Posture plans and measurements as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np


@dataclass(frozen=True)
class PosturePlan:
    """Postures to measure, in order; a placement's postures stand together.

    Attributes:
        joints: joint names, the columns of `joint_angles`.
        joint_angles: (m, n_joints) [rad].
        posture, placement: numbers, (m,).
        support: "double", "right" or "left" per posture, (m,).
        swing_pose: pose of the swing foot in the base frame, (m, 3) [m, m, rad].
        robot: the MJCF file that the plan was made for, {"model", "sha256"}.
        made: how the plan was made (objective, seed, ranges, margins, software).
        torques: feed-forward of the drives, (m, n_joints) [N m], by which the servos hold the posture
            without sagging and share the load between the feet as planned; None: none.
    """

    joints: tuple[str, ...]
    joint_angles: np.ndarray
    posture: np.ndarray
    placement: np.ndarray
    support: np.ndarray
    swing_pose: np.ndarray
    robot: dict[str, str]
    made: dict[str, Any] = field(default_factory=dict)
    torques: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.posture)

    @property
    def feed_forward(self) -> np.ndarray:
        """`torques`, or zeros, (m, n_joints) [N m]."""
        return np.zeros_like(self.joint_angles) if self.torques is None else self.torques

    @property
    def postures(self) -> int:
        """How many different ones, a repeated one counted once."""
        return len(np.unique(self.posture))

    def take(self, rows: np.ndarray) -> PosturePlan:
        """Some of its postures, by a mask or by indices in any order."""
        names = ("joint_angles", "posture", "placement", "support", "swing_pose")
        torques = None if self.torques is None else self.torques[rows]
        return replace(self, torques=torques, **{name: getattr(self, name)[rows] for name in names})


@dataclass(frozen=True)
class SensorSheet:
    """What the data sheets say of a posture's averaged reading (s.d. between postures); None: unknown."""

    encoder_sd: float | None = None
    encoder_resolution: float | None = None
    cell_sd: float | None = None
    cell_resolution: float | None = None
    placement_sd: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Measurements:
    """What was measured, one row per held posture. It holds nothing of a simulation's truth.

    Attributes:
        joints: joint names.
        posture, placement: numbers, (m,); a repeated posture repeats its number.
        support: "double", "right" or "left", (m,).
        time: start of the averaged window since the experiment began, (m,) [s].
        window: its length, (m,) [s].
        samples: its sample count, (m,).
        joint_angles, joint_angles_sd: mean and s.d. over the window, (m, n_joints) [rad].
        command: commanded angles, (m, n_joints) [rad], or None.
        motor: motor encoders over gear ratio, (m, n_joints) [rad], or None.
        cell_forces, cell_forces_sd: in the order of `CELLS`, (m, 8) [N].
        plate_poses: recorded poses of the right and left plate in the base frame, (m, 2, 3)
            [m, m, rad].
        cells: the cells' positions in their plate's frame, (2, 4, 2) [m].
        top_height: of the plates, (2,) [m].
        weighed_mass: value and s.d. [kg], or None.
        gravity: [m/s2].
        sensors: data-sheet figures.
        robot: {"model", "sha256", "stance_foot", "swing_foot"} of the nominal robot; sha256 None: not given.
    """

    joints: tuple[str, ...]
    posture: np.ndarray
    placement: np.ndarray
    support: np.ndarray
    time: np.ndarray
    window: np.ndarray
    samples: np.ndarray
    joint_angles: np.ndarray
    joint_angles_sd: np.ndarray
    command: np.ndarray | None
    motor: np.ndarray | None
    cell_forces: np.ndarray
    cell_forces_sd: np.ndarray
    plate_poses: np.ndarray
    cells: np.ndarray
    top_height: np.ndarray
    weighed_mass: tuple[float, float] | None
    gravity: float
    sensors: SensorSheet
    robot: dict[str, str | None]

    def __len__(self) -> int:
        return len(self.posture)


@dataclass(frozen=True)
class PlateGeometry:
    """A plate as its data sheet describes it.

    Attributes:
        cells: the four cells' positions in the plate's frame, in the order of `CORNERS`, (4, 2) [m].
        size: the board's extent in x and y, (2,) [m].
        top_height: height of the top surface over the floor [m].
        mass: the board's own mass [kg].
    """

    cells: np.ndarray
    size: np.ndarray
    top_height: float
    mass: float


def lay_boards(soles: np.ndarray, size: np.ndarray, gap: float) -> np.ndarray:
    """Poses of two parallel boards, each under its own sole and as central to it as the other allows.

    Args:
        soles: corners of the right and the left sole in the base frame, (2, 4, 2) [m].
        size: a board's extent in x and y, (2,) [m].
        gap: least distance between the boards' long edges [m].

    Returns:
        (2, 3) [m, m, rad] in the base frame.
    """
    centres = (soles.min(axis=1) + soles.max(axis=1)) / 2
    lack = max(0.0, size[1] + gap - (centres[1, 1] - centres[0, 1]))
    return np.array(
        [[centres[0, 0], centres[0, 1] - lack / 2, 0.0], [centres[1, 0], centres[1, 1] + lack / 2, 0.0]]
    )
