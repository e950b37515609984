"""Read a bag of ROS 2 in MCAP: angles of joints and wrenches."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import opened
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.measurements.logs.joined_clocks import Device, joined_devices

JOINTS, WRENCHES = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"


def read_ros(path: Path, files: Sequence[Path]) -> TableFile:
    """Read all joint states and wrenches of a bag, joined by the times in their headers.

    Columns are `JOINT position [rad]` and `TOPIC fx [N]` to `TOPIC mz [Nm]`.
    """
    streams: dict[tuple[str, ...], list[list[float]]] = defaultdict(list)  # by topic and columns
    for file in files:
        for stream, sample in _samples(file):
            streams[stream].append(sample)
    if not streams:
        raise InputError(f"{path}: found no message of {JOINTS} or {WRENCHES}, expected the log of a robot")
    devices = []
    for (topic, *columns), samples in streams.items():
        rows = np.array(sorted(samples))
        devices.append(Device(topic, rows[:, 0], tuple(columns), rows[:, 1:]))
    return joined_devices(path, devices)


def _samples(file: Path) -> Iterator[tuple[tuple[str, ...], list[float]]]:
    """Yield topic and columns of each message, and its time [s] and values."""
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise InputError(
            f"{file}: to read bags of ROS 2, install the extra `logs`: pip install 'tulip-testbed[logs]'"
        ) from None
    try:
        with opened(file) as stream:
            factory = DecoderFactory()
            for schema, channel, message in make_reader(stream).iter_messages():
                read = None if schema is None else READERS.get(schema.name)
                decode = None if read is None else factory.decoder_for(channel.message_encoding, schema)
                if read is None or decode is None:
                    continue
                decoded = decode(message.data)
                stamp = decoded.header.stamp
                time = stamp.sec + 1e-9 * stamp.nanosec or 1e-9 * message.log_time
                names, values = read(channel.topic, decoded)
                if len(names) == len(values):
                    yield (channel.topic, *names), [time, *values]
    except InputError:
        raise
    except Exception as error:  # the library raises errors of many kinds
        raise InputError(f"{file}: not a bag of ROS 2 in MCAP ({shortened(error, 120)})") from None


def _joints(topic: str, message: Any) -> tuple[list[str], list[float]]:
    return [f"{name} position [rad]" for name in message.name], list(message.position)


def _wrench(topic: str, message: Any) -> tuple[list[str], list[float]]:
    names = [f"{topic} {channel} [{'N' if channel[0] == 'f' else 'Nm'}]" for channel in WRENCH]
    force, moment = message.wrench.force, message.wrench.torque
    return names, [force.x, force.y, force.z, moment.x, moment.y, moment.z]


READERS = {JOINTS: _joints, WRENCHES: _wrench}
