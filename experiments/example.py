"""A manifest and a row to copy, for users who write a measurement folder by hand."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements import lay_boards
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES
from tulip_testbed.measurements.measurement_folder import required_columns
from tulip_testbed.sim.plates import plate_geometry
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import load_scene, nominal_plates

BOARD_GAP = 0.01  # m
GRAVITY = 9.81  # m/s2


def example_manifest(robot: Robot) -> dict[str, Any]:
    """Return a manifest for this robot on the plates of its scene; what only a laboratory knows is null."""
    scene, joints = load_scene(robot), nominal_robot(robot).parameters.tree.joints
    plates = {}
    for plate in PLATES:
        geometry = plate_geometry(scene, plate)
        cells = dict(zip(CORNERS, geometry.cells.tolist(), strict=True))
        plates[plate] = {"cells": cells, "top_height": geometry.top_height}
    return {
        "format": "tulip-measurements",
        "version": 1,
        "robot": {
            "model": robot.model_file.name,
            "sha256": None,
            "stance_foot": robot.stance_foot,
            "swing_foot": robot.swing_foot,
        },
        "joints": list(joints),
        "plates": plates,
        "weighed_mass": None,
        "gravity": GRAVITY,
        "sensors": {
            "encoder_sd": None,
            "encoder_resolution": None,
            "cell_sd": None,
            "cell_resolution": None,
            "placement_sd": None,
        },
    }


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


def compact_json(manifest: dict[str, Any]) -> str:
    """One line per key, as a person would write it."""
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in manifest.items()]
    return "{\n" + ",\n".join(lines) + "\n}"
