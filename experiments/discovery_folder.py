"""The run folder of a discovery."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from tulip_testbed.discovery.discover import Discovery
from tulip_testbed.experiments.rig_folder import write_rig
from tulip_testbed.identification.residual_channels import SIZE, residuals
from tulip_testbed.sim.files import new_folder, write_text
from tulip_testbed.sim.measurements import write_measurements
from tulip_testbed.sim.measurements.table_files import software, write_json
from tulip_testbed.sim.robot import Robot, sha256

PARTS = (
    *("cop_x_m", "cop_y_m", "force_N", "twist_right_N", "twist_left_N"),
    *("height_m", "roll_rad", "pitch_rad", "x_m", "y_m", "yaw_rad"),
)


def write_discovery(
    folder: Path, found: Discovery, document: dict[str, Any], robot: Robot, configuration: dict[str, Any]
) -> None:
    """Write discovery.json, story.txt, the residuals before and after, the measurements, the rig.

    The folder appears whole or not at all.

    Raises:
        InputError: it exists or cannot be written.
    """
    with new_folder(folder) as working:
        write_measurements(working / "measurements", found.observed.measurements)
        write_json(working / "discovery.json", document)
        write_text(working / "story.txt", "\n".join(document["story"]) + "\n")
        _write_residuals(working / "residuals.csv", found)
        if found.adopted:
            write_rig(working / "rig", robot, found.adopted)
        outputs = sorted(path for path in working.rglob("*") if path.is_file())
        write_json(
            working / "run.json",
            {
                "format": "tulip-run",
                "version": 1,
                "command": "discover",
                "configuration": configuration,
                "software": software(),
                "inputs": robot.hashes,
                "outputs": {str(path.relative_to(working)): sha256(path) for path in outputs},
            },
        )


def _write_residuals(path: Path, found: Discovery) -> None:
    """Write the raw residuals of every posture, as measured and with the effects removed."""
    sides = {
        "before": residuals(found.observed, found.selection.null.linear.theta),
        "after": residuals(found.fit.linear.observed, found.fit.linear.theta),
    }
    m = found.observed.measurements
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["posture", "placement", "time", *(f"{side}.{part}" for side in sides for part in PARTS)]
        )
        for k in range(len(found.observed)):
            values = [float(sides[side][k, j]) for side in sides for j in range(SIZE)]
            writer.writerow([int(m.posture[k]), int(m.placement[k]), float(m.time[k]), *values])
