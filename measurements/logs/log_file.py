"""Read a log of any known kind as one table."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import read_bytes
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements.logs.dumper_log import DATA, read_dumper
from tulip_testbed.measurements.logs.matlab_log import read_matlab
from tulip_testbed.measurements.logs.ros_log import read_ros

MOST_SAMPLES = 1_000_000  # rows of a log


def read_log(path: Path) -> TableFile:
    """Read a table, or a log whose devices are joined by time.

    Args:
        path: CSV, Parquet, `.mat` of MATLAB, `.mcap` of ROS 2 or the folder of its bag, or a folder of a
            dumper's devices.
    """
    if path.is_dir():
        if bags := sorted(path.glob("*.mcap")):
            return read_ros(path, bags)
        if devices := sorted(path.rglob(DATA)):
            return read_dumper(path, devices)
        raise InputError(
            f"{path}: found a folder without {DATA} or *.mcap in it, expected the log of a robot"
        )
    if path.suffix == ".mat":
        return read_matlab(path, read_bytes(path))
    if path.suffix == ".mcap":
        return read_ros(path, [path])
    return TableFile(path, read_bytes(path), MOST_SAMPLES)
