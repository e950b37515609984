"""What `tulip robot` prints."""

from __future__ import annotations

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import listed
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.robot_import.robot_import import ImportedRobot


def import_report(robot: ImportedRobot) -> list[Table | str]:
    """Return what was found and what was assumed, for a person."""
    found = robot.found
    corners = np.array(found["soles"][0])
    length, width = np.ptp(corners[:, :2], axis=0)
    torque = sorted(found["torque"].values())
    rows = [
        ("links, joints", f"{found['links']}, {found['joints']}"),
        ("mass", f"{found['mass']:.2f} kg"),
        ("free body", found["root"]),
        ("stance foot (right), swing foot (left)", listed(found["feet"])),
        ("sole", f"{1e3 * length:.0f} mm long, {1e3 * width:.0f} mm wide"),
        ("leg, hip to sole", f"{found['leg']:.3f} m"),
        ("joints between the feet", str(len(found["between_feet"]))),
        ("other joints (arms, head)", str(len(found["others"]))),
        ("torque limits", f"{torque[0]:.3g} to {torque[-1]:.3g} Nm"),
        ("standing posture", f"free body {found['height']:.3f} m above the soles"),
    ]
    title = f"{robot.name}, from {robot.source.name}"
    parts: list[Table | str] = [Table(title, (Column("found"), Column("value")), rows)]
    for title, lines in (("Assumed", robot.assumed), ("Problems", robot.problems)):
        if lines:
            parts += [f"{title}:", *(f"- {line}" for line in lines)]
    return parts
