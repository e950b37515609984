"""The start of a measurement folder: a manifest and a row to copy, or to fill in."""

import dataclasses
from typing import Any

import numpy as np

from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements import Measurements, SensorSheet, lay_boards
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.measurements.manifest import manifest_of, unset_keys
from tulip_testbed.measurements.measurement_folder import required_columns
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import nominal_plates

BOARD_GAP = 0.01  # m
GRAVITY = 9.81  # m/s2


def empty_measurements(robot: Robot, sensors: str | None) -> Measurements:
    """Return measurements without rows; without sensors: on four cells a foot that have no data sheet."""
    header = header_of(preset_rig(sensors or "ideal", robot))
    if sensors is None:
        header = dataclasses.replace(header, sensors=SensorSheet())
    return Measurements.without_rows(header)


def example_manifest(robot: Robot) -> dict[str, Any]:
    """Return a manifest for this robot on the plates of its scene; what only a laboratory knows is null."""
    empty = empty_measurements(robot, None)
    unknown = unset_keys(empty) | {"created", "software", "tables"}
    manifest = manifest_of(empty, {}).model_dump(mode="json", exclude=unknown)
    return manifest | {"robot": manifest["robot"] | {"sha256": None}}


def example_row(robot: Robot) -> dict[str, float]:
    """Return the columns that a posture needs, for the robot with all joints at zero."""
    nominal = nominal_robot(robot)
    joints = nominal.parameters.tree.joints
    angles = np.zeros((1, len(joints)))
    size = nominal_plates(robot)[0].size
    boards = lay_boards(nominal.soles_in_base(angles)[0], size, BOARD_GAP)
    share = round(nominal.mass * GRAVITY / len(CELLS), 2)
    values = [1, 1, *angles[0], *[share] * len(CELLS), *np.round(boards.ravel(), 4)]
    return {
        name: value if isinstance(value, int) else float(value)
        for name, value in zip(required_columns(joints), values, strict=True)
    }
