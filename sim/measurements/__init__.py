"""The data contract between a laboratory, simulated or real, and the identification."""

from tulip_testbed.sim.measurements.data import (
    Measurements,
    PlateGeometry,
    PosturePlan,
    SensorSheet,
    lay_boards,
)
from tulip_testbed.sim.measurements.measurement_folder import read_measurements, write_measurements
from tulip_testbed.sim.measurements.plan_folder import read_plan, write_plan
from tulip_testbed.sim.measurements.series import Series, read_series

__all__ = [
    "Measurements",
    "PlateGeometry",
    "PosturePlan",
    "SensorSheet",
    "Series",
    "lay_boards",
    "read_measurements",
    "read_plan",
    "read_series",
    "write_measurements",
    "write_plan",
]
