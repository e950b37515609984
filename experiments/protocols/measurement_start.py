"""The start of a measurement folder: what is known before the first row, and rows to fill in."""

from __future__ import annotations

import dataclasses

from tulip_testbed.measurements import Measurements, PosturePlan, SensorSheet
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot

KNOWN = ("posture", "placement", "support")  # columns that the protocol fills in


def empty_measurements(robot: Robot, sensors: str | None) -> Measurements:
    """Return measurements without rows: robot, joints, sensors and their data sheet, as far as known.

    Args:
        sensors: preset; None: four cells under each foot, without a data sheet.
    """
    header = header_of(preset_rig(sensors or "ideal", robot))
    if sensors is None:
        header = dataclasses.replace(header, sensors=SensorSheet())
    return Measurements.without_rows(header)


def rows_to_fill_in(empty: Measurements, plan: PosturePlan) -> str:
    """Return the rows to measure as CSV in the columns of the measurement folder, without readings."""
    columns = list(empty.columns())
    known = zip(*(getattr(plan, name).tolist() for name in KNOWN), strict=True)
    rows = [[str(dict(zip(KNOWN, row, strict=True)).get(name, "")) for name in columns] for row in known]
    return "\n".join(",".join(row) for row in [columns, *rows]) + "\n"


def unknown_entries(empty: Measurements) -> list[str]:
    """Name the entries of the manifest that a person has to fill in."""
    sheet = dataclasses.asdict(empty.sensors)
    cells = empty.contacts is None
    wanted = [name for name, value in sheet.items() if value is None and (cells or "cell" not in name)]
    return ["weighed_mass", *(f"sensors.{name}" for name in wanted)]
