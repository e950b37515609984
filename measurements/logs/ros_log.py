"""Read a bag of ROS 2 in MCAP: angles of joints and wrenches."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import opened
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.measurements.logs.joined_clocks import Device, joined_devices

JOINTS, WRENCHES = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"


class _Sample(NamedTuple):
    """A message: its stream (a topic may carry several sets of joints), time [s] and values."""

    stream: tuple[str, tuple[str, ...]]
    time: float
    values: list[float]


def read_ros(path: Path, files: Sequence[Path]) -> TableFile:
    """Read all joint states and wrenches of a bag, joined by the times in their headers.

    Columns are `JOINT position [rad]` and `TOPIC fx [N]` to `TOPIC mz [Nm]`.

    Raises:
        InputError: the library is not installed, a file that is no MCAP, a bag without such messages, or
            clocks that do not overlap.
    """
    streams: dict[tuple[str, tuple[str, ...]], list[_Sample]] = defaultdict(list)
    for file in files:
        for sample in _samples(file):
            streams[sample.stream].append(sample)
    if not streams:
        raise InputError(f"{path}: found no message of {JOINTS} or {WRENCHES}, expected the log of a robot")
    devices = []
    for (topic, columns), samples in streams.items():
        samples.sort(key=lambda one: one.time)
        values = np.array([one.values for one in samples], float)
        devices.append(Device(topic, np.array([one.time for one in samples]), columns, values))
    return joined_devices(path, devices)


def _samples(file: Path) -> Iterator[_Sample]:
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise InputError(
            f"{file}: to read bags of ROS 2, install the extra `logs`: pip install 'tulip-testbed[logs]'"
        ) from None
    try:
        with opened(file) as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            kinds = {} if summary is None else {one.id: one.name for one in summary.schemas.values()}
            topics = [
                channel.topic
                for channel in (() if summary is None else summary.channels.values())
                if kinds.get(channel.schema_id) in (JOINTS, WRENCHES)
            ]
            if topics:
                for schema, channel, message, decoded in reader.iter_decoded_messages(topics):
                    assert schema is not None  # it was looked up by its name
                    if schema.name == WRENCHES or len(decoded.position) == len(decoded.name):
                        yield _sample(schema.name, channel.topic, message.log_time, decoded)
    except InputError:
        raise
    except Exception as error:  # the library raises errors of many kinds
        raise InputError(f"{file}: not a bag of ROS 2 in MCAP ({shortened(error, 120)})") from None


def _sample(kind: str, topic: str, logged: int, message: Any) -> _Sample:
    stamp = message.header.stamp
    time = stamp.sec + 1e-9 * stamp.nanosec or 1e-9 * logged
    if kind == JOINTS:
        names = tuple(f"{name} position [rad]" for name in message.name)
        return _Sample((topic, names), time, list(message.position))
    force, moment = message.wrench.force, message.wrench.torque
    names = tuple(f"{topic} {channel} [{'N' if channel[0] == 'f' else 'Nm'}]" for channel in WRENCH)
    return _Sample((topic, names), time, [*(force.x, force.y, force.z), *(moment.x, moment.y, moment.z)])
