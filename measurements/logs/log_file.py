"""Read a log of any known kind as one table."""

import io
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import opened, read_bytes
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.measurements.logs.joined_clocks import Device, joined_devices

DATA = "data.log"
PLAIN = bytes.maketrans(b"()", b"  ")  # a dumper writes lists in brackets
JOINTS, WRENCHES = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
LEAST_SAMPLES = 10  # of a log; shorter arrays are figures
MOST_DEPTH = 8  # of structures
MOST_SAMPLES = 1_000_000  # rows of a log


def _device(folder: Path, file: Path) -> Device:
    """Read a device of a dumper, named after its folder; its columns are DEVICE.1, DEVICE.2, ..."""
    name = ".".join(file.parent.relative_to(folder).parts) or folder.name
    content = read_bytes(file).translate(PLAIN)
    if not content.strip():
        raise InputError(f"{file}: found no samples, expected lines `index time v1 v2 ...`")
    try:
        numbers = np.loadtxt(io.BytesIO(content), ndmin=2)
    except ValueError as error:
        reason = shortened(str(error).partition(";")[0], 120)  # without numpy's advice to programmers
        raise InputError(
            f"{file}: {reason}; expected lines `index time v1 v2 ...` of numbers alone"
        ) from None
    if numbers.shape[1] < 3:
        raise InputError(f"{file}: found {numbers.shape[1]} numbers a line, expected `index time v1 v2 ...`")
    columns = tuple(f"{name}.{k}" for k in range(1, numbers.shape[1] - 1))
    return Device(name, numbers[:, 1], columns, numbers[:, 2:])


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


def read_matlab(path: Path, content: bytes) -> TableFile:
    """Read all arrays of numbers that have as many samples as most.

    Fields of structures are named `a.b.c`, the columns of a matrix `name.1`, `name.2`, ...; samples may run
    along either axis.
    """
    try:
        found = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True)
    except NotImplementedError:
        raise InputError(
            f"{path}: found MATLAB 7.3 (HDF5), expected 5 to 7.2; in MATLAB, save('x.mat', '-v7')"
        ) from None
    except Exception as error:  # scipy raises errors of many kinds
        raise InputError(f"{path}: not a MATLAB file ({shortened(error, 120)})") from None
    arrays = dict(_arrays("", {name: value for name, value in found.items() if not name.startswith("__")}, 0))
    sizes = Counter[int]()
    for values in arrays.values():
        sizes[max(values.shape)] += values.size
    samples = max((n for n in sizes if n >= LEAST_SAMPLES), key=lambda n: (sizes[n], n), default=0)
    if not samples:
        raise InputError(f"{path}: found no array of {LEAST_SAMPLES} numbers or more, expected a log")
    columns = {}
    for name, values in arrays.items():
        if samples not in values.shape:
            continue
        rows = np.moveaxis(values, values.shape.index(samples), 0).reshape(samples, -1).astype(float)
        single = values.ndim == 1
        columns |= {name if single else f"{name}.{k + 1}": rows[:, k] for k in range(rows.shape[1])}
    return TableFile.of_columns(path, columns)


def _arrays(name: str, value: Any, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Walk through structures; the elements of a list of structures are numbered."""
    if depth > MOST_DEPTH:
        return
    if isinstance(value, dict):
        fields = list(value.items())
    elif not isinstance(value, np.ndarray | np.void):
        return
    elif value.dtype.names:
        if value.ndim:
            fields = [(str(k + 1), one) for k, one in enumerate(value.ravel())]
        else:
            fields = [(field, value[field]) for field in value.dtype.names]
    elif value.dtype == object:
        fields = [("", value.item())] if value.size == 1 else []
    else:
        if isinstance(value, np.ndarray) and value.ndim and value.dtype.kind in "iufb":
            yield name, value
        return
    for field, one in fields:
        yield from _arrays(".".join(filter(None, (name, field))), one, depth + 1)


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
            return joined_devices(path, [_device(path, file) for file in devices])
        raise InputError(
            f"{path}: found a folder without {DATA} or *.mcap in it, expected the log of a robot"
        )
    if path.suffix == ".mat":
        return read_matlab(path, read_bytes(path))
    if path.suffix == ".mcap":
        return read_ros(path, [path])
    return TableFile(path, read_bytes(path), MOST_SAMPLES)
