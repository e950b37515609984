"""Posture plans, measurements and plate geometry as plain arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from tulip_testbed.base.errors import InputError, listed, look_up
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.measurements.contacts import COP, cops_of_wrenches
from tulip_testbed.measurements.header import MeasurementHeader
from tulip_testbed.measurements.trajectory import Trajectory


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
        motion: between the postures, of a plan that moves; None: it is held at every posture.
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
    motion: Trajectory | None = None

    def __len__(self) -> int:
        return len(self.posture)

    def __repr__(self) -> str:
        return f"PosturePlan: {_described(self)}, robot {self.robot['model']}"

    def wrong_shape(self) -> str:
        """Say which array has another type or shape than a plan's; "" if none has."""
        rows: tuple[Any, ...] = np.shape(self.posture) if np.ndim(self.posture) == 1 else ("rows",)
        shapes = dict.fromkeys(("posture", "placement", "support"), rows) | {"swing_pose": (*rows, 3)}
        joints = dict.fromkeys(("joint_angles", "torques"), (*rows, len(self.joints)))
        return wrong_arrays(self, shapes | joints)

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

    def take(self, rows: np.ndarray) -> Self:
        """Select postures by a mask or by indices in any order, without a motion."""
        names = ("joint_angles", "posture", "placement", "support", "swing_pose")
        torques = None if self.torques is None else self.torques[rows]
        return replace(
            self, torques=torques, motion=None, **{name: getattr(self, name)[rows] for name in names}
        )


OF_ROWS = (  # fields of `Measurements` with a value for every row
    *("posture", "placement", "support", "time", "window", "samples"),
    *("joint_angles", "joint_angles_sd", "command", "motor", "cell_forces", "cell_forces_sd"),
    *("plate_poses", "wrenches", "wrenches_sd", "speed", "acceleration", "experiment"),
    *("joint_rates", "joint_accelerations", "joint_jerks", "cell_rates", "cell_accelerations"),
    *("wrench_rates", "wrench_accelerations", "wrench_jerks"),
)
OF_JOINTS = {  # fields with a value for every joint, by the prefix of their columns
    "q": "joint_angles",
    "q_std": "joint_angles_sd",
    "q_command": "command",
    "motor": "motor",
    "q_rate": "joint_rates",
    "q_acceleration": "joint_accelerations",
}
OF_WRENCHES = {  # fields with a value for every channel of both wrench sensors, likewise
    "wrench": "wrenches",
    "wrench_std": "wrenches_sd",
    "wrench_rate": "wrench_rates",
    "wrench_acceleration": "wrench_accelerations",
    "wrench_jerk": "wrench_jerks",
}
KINDS = {"posture": "iu", "placement": "iu", "support": "U"}  # of numbers, where they are not any
OF_KIND = {"iu": "whole numbers", "iuf": "numbers", "U": "texts"}
UNUSUAL = (np.float16, np.longdouble)  # of three digits, and of no use to linear algebra
MAY_BE_NONE = (
    *("command", "motor", "torques", "wrenches_sd", "speed", "acceleration"),
    *("joint_rates", "joint_accelerations", "joint_jerks", "cell_rates", "cell_accelerations"),
    *("wrench_rates", "wrench_accelerations", "wrench_jerks"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Measurements(MeasurementHeader):
    """A header and its rows, one per held posture; they do not contain a simulation's truth.

    Attributes:
        posture, placement: numbers, (m,); a repeated posture repeats its number.
        support: "double", "right" or "left", (m,).
        time: start of the averaged window since the start of the experiment, (m,) [s].
        window: length of the averaged window, (m,) [s].
        samples: number of samples in the window, (m,).
        joint_angles, joint_angles_sd: mean and s.d. over the window, (m, n_joints) [rad].
        command: commanded angles, (m, n_joints) [rad], or None.
        motor: motor encoders over gear ratio, (m, n_joints) [rad], or None.
        cell_forces, cell_forces_sd: in the order of `CELLS`, (m, 8) [N]; (m, 0) with wrench sensors.
        plate_poses: recorded poses of the right and left plate in the base frame, (m, 2, 3)
            [m, m, rad]; in "left" support it is the frame of the left foot; 0 with sensors in the feet.
        wrenches, wrenches_sd: readings of the wrench sensors, right and left, mean and s.d. over the window,
            (m, 2, c) [N, Nm]; NaN for a foot in the air that was not recorded; None: cells.
        speed: largest speed of a joint in the window, (m,) [rad/s], or None.
        acceleration: of the robot's base in the window, (m,) [m/s2], or None.
        joint_rates, joint_accelerations: of a robot that moves, (m, n_joints) [rad/s, rad/s2]; None: held.
        joint_jerks: third derivative of the angles, (m, n_joints) [rad/s3], of rows that were reduced in
            memory; None: no folder of rows holds it.
        cell_rates, cell_accelerations: first and second derivative of the cells' readings, (m, 8) [N/s,
            N/s2], likewise.
        wrench_rates, wrench_accelerations, wrench_jerks: first to third derivative of the wrench sensors'
            readings, (m, 2, c) [N/s, Nm/s; N/s2, Nm/s2; N/s3, Nm/s3], means over the window; None: not known.
        experiment: index of every row's experiment, (m,); None: there is at most one.
    """

    posture: np.ndarray
    placement: np.ndarray
    support: np.ndarray
    time: np.ndarray
    window: np.ndarray
    samples: np.ndarray
    joint_angles: np.ndarray
    joint_angles_sd: np.ndarray
    command: np.ndarray | None = None
    motor: np.ndarray | None = None
    cell_forces: np.ndarray
    cell_forces_sd: np.ndarray
    plate_poses: np.ndarray
    wrenches: np.ndarray | None = None
    wrenches_sd: np.ndarray | None = None
    speed: np.ndarray | None = None
    acceleration: np.ndarray | None = None
    joint_rates: np.ndarray | None = None
    joint_accelerations: np.ndarray | None = None
    joint_jerks: np.ndarray | None = None
    cell_rates: np.ndarray | None = None
    cell_accelerations: np.ndarray | None = None
    wrench_rates: np.ndarray | None = None
    wrench_accelerations: np.ndarray | None = None
    wrench_jerks: np.ndarray | None = None
    experiment: np.ndarray | None = None

    @classmethod
    def from_arrays(cls, header: MeasurementHeader, **rows: Any) -> Self:
        """Return measurements that were made in memory.

        Args:
            header: robot, joints and sensors.
            rows: values of every row by the name of their field. Needed are `joint_angles`, `placement`, and
                the readings: `cell_forces` or `wrenches`, and `plate_poses` for plates. Without the others,
                postures are numbered, stand on both feet, and times, windows and s.d. are unknown.

        Raises:
            InputError: names the field that is unknown, missing, or of another shape.
        """
        for name in rows:
            look_up("field", name, OF_ROWS, "measurements")
        readings = ["cell_forces" if header.contacts is None else "wrenches"]
        needed = ["joint_angles", "placement", *readings, *["plate_poses"] * header.on_plates]
        if missing := [name for name in needed if rows.get(name) is None]:
            raise InputError(f"measurements: found no {listed(missing)}, expected values of every row")
        try:
            given = {name: np.asarray(value) for name, value in rows.items() if value is not None}
        except ValueError as error:
            raise InputError(f"measurements: found no array of numbers ({error})") from None
        m = len(np.atleast_1d(given["joint_angles"]))
        usual: dict[str, Any] = {
            "posture": np.arange(1, m + 1),
            "support": np.full(m, "double"),
            **{name: np.full(m, np.nan) for name in ("time", "window", "samples")},
            "cell_forces": np.zeros((m, 0)),
            "plate_poses": np.zeros((m, 2, 3)),
        } | given
        for name in ("joint_angles", "cell_forces", "wrenches"):
            if name in usual:
                usual.setdefault(f"{name}_sd", np.full(usual[name].shape, np.nan))
        made = cls(**header.stated, **usual)
        if wrong := made.wrong_shape():
            raise InputError(f"measurements: {wrong}")
        return made

    @classmethod
    def without_rows(cls, header: MeasurementHeader) -> Self:
        """Return measurements to which rows are to be appended."""
        channels = 0 if header.contacts is None else len(header.contacts.channels)
        rows: dict[str, Any] = {
            "placement": np.zeros(0, int),
            "joint_angles": np.zeros((0, len(header.joints))),
            "cell_forces": np.zeros((0, 0 if channels else len(CELLS))),
            "plate_poses": np.zeros((0, len(PLATES), 3)),
            "wrenches": np.zeros((0, len(PLATES), channels)) if channels else None,
        }
        return cls.from_arrays(header, **rows)

    @property
    def header(self) -> MeasurementHeader:
        """Return the header alone."""
        return MeasurementHeader(**self.stated)

    def wrong_shape(self) -> str:
        """Say which array has another type or shape than the contract's; "" if none has."""
        rows: tuple[Any, ...] = np.shape(self.posture) if np.ndim(self.posture) == 1 else ("rows",)
        joints, sides = (*rows, len(self.joints)), (*rows, len(PLATES))
        cells = len(CELLS) if self.contacts is None else 0
        channels = 0 if self.contacts is None else len(self.contacts.channels)
        shapes = {
            **dict.fromkeys(("posture", "placement", "support", "time", "window", "samples"), rows),
            **dict.fromkeys(OF_JOINTS.values(), joints),
            **dict.fromkeys([name for name in OF_ROWS if name.startswith("cell_")], (*rows, cells)),
            "plate_poses": (*sides, 3),
            "cells": (len(PLATES), cells // len(PLATES), 2),
            "top_height": (len(PLATES),),
            **dict.fromkeys(OF_WRENCHES.values() if channels else (), (*sides, channels)),
            **dict.fromkeys(("speed", "acceleration"), rows),
        }
        return wrong_arrays(self, shapes)

    def __len__(self) -> int:
        return len(self.posture)

    def __repr__(self) -> str:
        return f"Measurements: {len(self)} rows, {_described(self)}, robot {self.robot['model']}"

    @property
    def of_experiment(self) -> np.ndarray:
        """Return the index of every row's experiment, (m,)."""
        return np.zeros(len(self), int) if self.experiment is None else self.experiment

    def take(self, rows: np.ndarray) -> Self:
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
        for prefix, name in OF_JOINTS.items():
            if (values := getattr(self, name)) is not None:
                columns |= {f"{prefix}.{self.joints[k]}": values[:, k] for k in logged}
        columns |= self._contact_columns()
        if self.on_plates:
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
        return {
            f"{prefix}.{side}.{channel}": values[:, p, k]
            for prefix, name in OF_WRENCHES.items()
            if (values := getattr(self, name)) is not None
            for p, side in enumerate(PLATES)
            for k, channel in enumerate(self.contacts.channels)
        }

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with the columns of a measurement folder [SI]."""
        import pandas as pd

        return pd.DataFrame(self.columns())


def wrong_arrays(holder: Any, shapes: dict[str, tuple[Any, ...]]) -> str:
    """Say which array has another type or shape than is stated by its name; "" if none has."""
    for name, shape in shapes.items():
        array, kind = getattr(holder, name), KINDS.get(name, "iuf")
        if array is None and name in MAY_BE_NONE:
            continue
        there = isinstance(array, np.ndarray) and not isinstance(array, np.ma.MaskedArray)
        usual = there and array.dtype.kind in kind and array.dtype not in UNUSUAL
        if not usual or array.shape != shape:
            seen = f"{array.dtype} {array.shape}" if there else type(array).__name__
            size = ", ".join(map(str, shape))
            return f"{name}: found {seen}, expected an array of {OF_KIND[kind]} ({size})"
    return ""


def stacked(parts: Sequence[Measurements]) -> Measurements:
    """Return the rows of measurements with one header, in order; what one of them lacks is left out."""
    rows: dict[str, Any] = {}
    for name in OF_ROWS:
        values = [getattr(one, name) for one in parts]
        rows[name] = None if any(v is None for v in values) else np.concatenate(values)
    return replace(parts[0], **rows)


def feet_in_contact(support: np.ndarray) -> np.ndarray:
    """Return whether the right and the left foot are on the ground, (m, 2) bool."""
    return np.column_stack([support != "left", support != "right"])


def vertical_forces(measurements: Measurements) -> np.ndarray:
    """Return the vertical force on the right and the left foot, zero in the air, (m, 2) [N]."""
    m = measurements
    if m.contacts is None:
        down = m.cell_forces.reshape(-1, 2, 4).sum(axis=2)
    else:
        assert m.wrenches is not None
        down = m.wrenches[..., m.contacts.channels.index("fz")]
    return np.where(feet_in_contact(m.support), down, 0.0)


def base_foot(support: np.ndarray) -> np.ndarray:
    """Return the index of the foot that carries the base frame, (m,) int: 0, right, unless in the air."""
    return feet_in_contact(support).argmax(axis=1)


def _described(rows: PosturePlan | Measurements) -> str:
    counts = f"{len(np.unique(rows.posture))} postures on {len(np.unique(rows.placement))} placements"
    return f"{counts}, support {', '.join(np.unique(rows.support).tolist())}"
