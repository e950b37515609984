"""Posture plans, measurements and plate geometry as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.measurements.contacts import COP, Contacts, cops_of_wrenches
from tulip_testbed.measurements.manipulations import Experiment


@dataclass(frozen=True, eq=False)
class PosturePlan:
    """Postures to measure, in order; the postures of a placement are consecutive.

    Attributes:
        joints: joint names, the columns of `joint_angles`.
        joint_angles: (m, n_joints) [rad].
        posture, placement: numbers, (m,).
        support: "double", "right" or "left" per posture, (m,).
        swing_pose: pose in the base frame of the foot that does not carry it, which is the swing foot in
            "double" and "right" support, the stance foot in "left" support, (m, 3) [m, m, rad].
        robot: MJCF file of the plan's robot, {"model", "sha256"}.
        made: settings that made the plan (objective, seed, ranges, margins, software).
        torques: feed-forward torques of the drives, (m, n_joints) [N m], with which the servos hold the
            posture without sag and share the load between the feet as planned; None: no feed-forward.
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

    def __repr__(self) -> str:
        return f"PosturePlan: {_described(self)}, robot {self.robot['model']}"

    @property
    def foot_poses(self) -> np.ndarray:
        """Return the planned poses of right and left foot in the base frame, (m, 2, 3) [m, m, rad]."""
        poses = np.zeros((len(self), 2, 3))
        poses[np.arange(len(self)), 1 - base_foot(self.support)] = self.swing_pose
        return poses

    @property
    def feed_forward(self) -> np.ndarray:
        """Return `torques`, or zeros if there are none, (m, n_joints) [N m]."""
        return np.zeros_like(self.joint_angles) if self.torques is None else self.torques

    @property
    def postures(self) -> int:
        """Count the different postures; a repeated one counts once."""
        return len(np.unique(self.posture))

    def take(self, rows: np.ndarray) -> PosturePlan:
        """Select postures by a mask or by indices in any order."""
        names = ("joint_angles", "posture", "placement", "support", "swing_pose")
        torques = None if self.torques is None else self.torques[rows]
        return replace(self, torques=torques, **{name: getattr(self, name)[rows] for name in names})


@dataclass(frozen=True)
class SensorSheet:
    """Data-sheet s.d. and resolution of a posture's averaged readings; None means unknown."""

    encoder_sd: float | None = None
    encoder_resolution: float | None = None
    cell_sd: float | None = None
    cell_resolution: float | None = None
    placement_sd: tuple[float, float, float] | None = None


OF_ROWS = (  # fields of `Measurements` with a value for every row
    *("posture", "placement", "support", "time", "window", "samples"),
    *("joint_angles", "joint_angles_sd", "command", "motor", "cell_forces", "cell_forces_sd"),
    *("plate_poses", "wrenches", "wrenches_sd", "speed", "acceleration", "experiment"),
)


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measurements, one row per held posture; they do not contain a simulation's truth.

    Attributes:
        joints: joint names.
        posture, placement: numbers, (m,); a repeated posture repeats its number.
        support: "double", "right" or "left", (m,).
        time: start of the averaged window since the start of the experiment, (m,) [s].
        window: length of the averaged window, (m,) [s].
        samples: number of samples in the window, (m,).
        joint_angles, joint_angles_sd: mean and s.d. over the window, (m, n_joints) [rad].
        command: commanded angles, (m, n_joints) [rad], or None.
        motor: motor encoders over gear ratio, (m, n_joints) [rad], or None.
        cell_forces, cell_forces_sd: in the order of `CELLS`, (m, 8) [N].
        plate_poses: recorded poses of the right and left plate in the base frame, (m, 2, 3)
            [m, m, rad]; in "left" support it is the frame of the left foot.
        cells: the cells' positions in their plate's frame, (2, 4, 2) [m].
        top_height: height of the plates' top surface over the floor, (2,) [m].
        weighed_mass: value and s.d. [kg], or None.
        gravity: acceleration of gravity [m/s2].
        sensors: data-sheet figures.
        robot: {"model", "sha256", "stance_foot", "swing_foot"} of the nominal robot; sha256 may be None.
        gains: of the joints' servos, torque per error of the angle, by joint [Nm/rad]; one that is not
            stated is in proportion to the torque limit.
        tolerances: of families of ordinary imperfections by name, where they are known better than by the
            sensors [SI]; zero: exact.
        contacts: wrench sensors in place of the plates' cells; None: cells. With them there are no cells:
            `cell_forces` is (m, 0) and `cells` (2, 0, 2); in the feet, `plate_poses` and `top_height` are 0.
        wrenches, wrenches_sd: readings of the wrench sensors, right and left, mean and s.d. over the window,
            (m, 2, c) [N, Nm]; NaN for a foot in the air that was not recorded; None: cells.
        constant_joints: s.d. of joints that are not logged but known to stand still, by name [rad].
        speed: largest speed of a joint in the window, (m,) [rad/s], or None.
        acceleration: of the robot's base in the window, (m,) [m/s2], or None.
        experiments: session and manipulations of each of several experiments that were joined, or of this
            one where they are stated; empty: nothing is stated.
        experiment: index of every row's experiment, (m,); None: there is at most one.
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
    gains: Mapping[str, float] = field(default_factory=dict)
    tolerances: Mapping[str, float] = field(default_factory=dict)
    contacts: Contacts | None = None
    wrenches: np.ndarray | None = None
    wrenches_sd: np.ndarray | None = None
    constant_joints: Mapping[str, float] = field(default_factory=dict)
    speed: np.ndarray | None = None
    acceleration: np.ndarray | None = None
    experiments: tuple[Experiment, ...] = ()
    experiment: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.posture)

    def __repr__(self) -> str:
        return f"Measurements: {len(self)} rows, {_described(self)}, robot {self.robot['model']}"

    @property
    def of_experiment(self) -> np.ndarray:
        """Return the index of every row's experiment, (m,)."""
        return np.zeros(len(self), int) if self.experiment is None else self.experiment

    def take(self, rows: np.ndarray) -> Measurements:
        """Select rows by a mask or by indices in any order."""
        values = {name: getattr(self, name) for name in OF_ROWS}
        return replace(self, **{name: v[rows] for name, v in values.items() if v is not None})

    def columns(self) -> dict[str, np.ndarray]:
        """Return the rows as columns by the names that they have in a measurement folder, (m,) each.

        A joint that is not logged has none.
        """
        columns = {
            name: getattr(self, name)
            for name in ("posture", "placement", "support", "time", "window", "samples")
        }
        columns |= {
            name: values for name in ("speed", "acceleration") if (values := getattr(self, name)) is not None
        }
        logged = tuple(k for k, joint in enumerate(self.joints) if joint not in self.constant_joints)
        for prefix, values in (
            ("q", self.joint_angles),
            ("q_std", self.joint_angles_sd),
            ("q_command", self.command),
            ("motor", self.motor),
        ):
            if values is not None:
                columns |= {f"{prefix}.{self.joints[k]}": values[:, k] for k in logged}
        columns |= self._contact_columns()
        if self.contacts is None or self.contacts.mount == "ground":
            for p, plate in enumerate(PLATES):
                for k, axis in enumerate(("x", "y", "yaw")):
                    columns[f"plate.{plate}.{axis}"] = self.plate_poses[:, p, k]
        return columns

    def _contact_columns(self) -> dict[str, np.ndarray]:
        if self.contacts is None:
            readings = (("cell", self.cell_forces), ("cell_std", self.cell_forces_sd))
            return {f"{pre}.{name}": values[:, k] for pre, values in readings for k, name in enumerate(CELLS)}
        if self.contacts.cop_sd is not None and self.wrenches is not None:
            cops = cops_of_wrenches(self.wrenches)
            return {
                f"cop.{side}.{axis}": cops[:, p, k]
                for p, side in enumerate(PLATES)
                for k, axis in enumerate(COP)
            }
        readings = (("wrench", self.wrenches), ("wrench_std", self.wrenches_sd))
        return {
            f"{prefix}.{side}.{channel}": values[:, p, k]
            for prefix, values in readings
            if values is not None
            for p, side in enumerate(PLATES)
            for k, channel in enumerate(self.contacts.channels)
        }

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with the columns of a measurement folder [SI]."""
        import pandas as pd

        return pd.DataFrame(self.columns())


def feet_in_contact(support: np.ndarray) -> np.ndarray:
    """Return whether the right and the left foot are on the ground, (m, 2) bool."""
    return np.column_stack([support != "left", support != "right"])


def base_foot(support: np.ndarray) -> np.ndarray:
    """Return the index of the foot that carries the base frame, (m,) int: 0, right, unless in the air."""
    return feet_in_contact(support).argmax(axis=1)


def _described(rows: PosturePlan | Measurements) -> str:
    """Count postures and placements, and name the supports."""
    counts = f"{len(np.unique(rows.posture))} postures on {len(np.unique(rows.placement))} placements"
    return f"{counts}, support {', '.join(np.unique(rows.support).tolist())}"


@dataclass(frozen=True)
class PlateGeometry:
    """Geometry of a plate as on its data sheet.

    Attributes:
        cells: positions of the four cells in the plate's frame, in the order of `CORNERS`, (4, 2) [m].
        size: extent of the board in x and y, (2,) [m].
        top_height: height of the top surface over the floor [m].
        mass: mass of the board [kg].
    """

    cells: np.ndarray
    size: np.ndarray
    top_height: float
    mass: float


def lay_boards(soles: np.ndarray, size: np.ndarray, gap: float) -> np.ndarray:
    """Place two parallel boards, each under its sole and as central to it as the other board allows.

    Args:
        soles: corners of the right and the left sole in the base frame, (2, 4, 2) [m].
        size: extent of a board in x and y, (2,) [m].
        gap: smallest distance between the boards' long edges [m].

    Returns:
        Poses of the right and the left board in the base frame, (2, 3) [m, m, rad].
    """
    centres = (soles.min(axis=1) + soles.max(axis=1)) / 2
    lack = max(0.0, size[1] + gap - (centres[1, 1] - centres[0, 1]))
    return np.array(
        [[centres[0, 0], centres[0, 1] - lack / 2, 0.0], [centres[1, 0], centres[1, 1] + lack / 2, 0.0]]
    )
