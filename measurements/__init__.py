"""The data contract between a laboratory, simulated or real, and the identification."""

from tulip_testbed.measurements.cells import PlateGeometry, lay_boards
from tulip_testbed.measurements.data import Measurements, PosturePlan
from tulip_testbed.measurements.header import MeasurementHeader, SensorSheet
from tulip_testbed.measurements.joined import as_joined, joined
from tulip_testbed.measurements.manipulations import Experiment
from tulip_testbed.measurements.measurement_folder import (
    read_measurements,
    read_samples,
    write_measurements,
    write_motion,
)
from tulip_testbed.measurements.series import Series, read_series

__all__ = [
    "Experiment",
    "MeasurementHeader",
    "Measurements",
    "PlateGeometry",
    "PosturePlan",
    "SensorSheet",
    "Series",
    "as_joined",
    "joined",
    "lay_boards",
    "read_measurements",
    "read_samples",
    "read_series",
    "write_measurements",
    "write_motion",
]
