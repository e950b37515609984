"""Logs of a person who bows, as laboratories write them: tables, MATLAB, YARP, ROS 2; and broken ones."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import scipy.io

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")


def motion(time):
    """Return angles, rates and accelerations of a person who bows with up to 1 Hz, (n, 2) each."""
    turn, size = 2 * np.pi * np.array([[0.13, 0.4], [0.31, 1.0]]), np.array([[0.03, 0.3], [0.01, 0.03]])
    phase = turn * time[:, None, None]
    value = size * np.sin(phase), size * turn * np.cos(phase), -size * turn**2 * np.sin(phase)
    return tuple(one.sum(axis=1) for one in value)


JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
WRENCH_STAMPED = """std_msgs/Header header
geometry_msgs/Wrench wrench
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
CLOCK = np.arange(300) / 100
ANGLES, _, _ = motion(CLOCK)
WRENCHES = np.column_stack([np.sin(CLOCK + k) * 10 + 600 * (k == 2) for k in range(6)])
NAMES = ("ankle", "hip")


def unit(channel):
    return "N" if channel[0] == "f" else "Nm"


def write_table(path, time=("t_s", CLOCK)):
    columns = dict([time])
    columns |= {f"{name}_rad": ANGLES[:, k] for k, name in enumerate(NAMES)}
    columns |= {f"right_foot_{name}_{unit(name)}": WRENCHES[:, k] for k, name in enumerate(CHANNELS)}
    if path.suffix == ".parquet":
        pyarrow.parquet.write_table(pa.table({name: pa.array(v) for name, v in columns.items()}), path)
    else:
        rows, names = np.column_stack(list(columns.values())), ",".join(columns)
        np.savetxt(path, rows, "%.17g", ",", header=names, comments="")


def write_matlab(path):
    log = {"t": CLOCK, "joints": {"q": ANGLES.T}, "foot": {"wrench": {"right": WRENCHES}}, "gain": np.eye(4)}
    scipy.io.savemat(path, {"log": log})


def write_dumper(path, change=lambda device, rows: rows):
    for device, values in (("legs", ANGLES), ("feet/right", WRENCHES)):
        (path / device).mkdir(parents=True)
        rows = np.column_stack([np.arange(len(CLOCK)), CLOCK + 1e9, values])
        np.savetxt(path / device / "data.log", change(device, rows), "%.17g")


def write_ros(path):
    writer_of = pytest.importorskip("mcap_ros2.writer").Writer
    with path.open("wb") as file:
        writer = writer_of(file)
        joints = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE + HEADER)
        wrenches = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", WRENCH_STAMPED + HEADER)
        for time, angles, wrench in zip(CLOCK, ANGLES, WRENCHES, strict=True):
            header = {"stamp": {"sec": 5 + int(time), "nanosec": round(1e9 * (time % 1))}, "frame_id": ""}
            state = {"header": header, "name": list(NAMES), "position": angles.tolist()}
            writer.write_message("/joint_states", joints, state | {"velocity": [], "effort": []})
            vectors = [dict(zip("xyz", part, strict=True)) for part in (wrench[:3], wrench[3:])]
            content = dict(zip(("force", "torque"), vectors, strict=True))
            writer.write_message("/right_foot/wrench", wrenches, {"header": header, "wrench": content})
        writer.finish()


def stated_wrench(name):
    return [f"wrench.right.{c}={name}.{k + 1}:{unit(c)}:1" for k, c in enumerate(CHANNELS)]


KINDS = {
    "log.csv": (write_table, []),
    "log.parquet": (write_table, []),
    "of-a-bag.csv": (lambda path: write_table(path, ("timestamp_ns", 1.7e18 + 1e9 * CLOCK)), []),
    "log.mat": (
        write_matlab,
        [
            *("time=log.t:s:1", "q.ankle=log.joints.q.1:rad:1", "q.hip=log.joints.q.2:rad:1"),
            *stated_wrench("log.foot.wrench.right"),
        ],
    ),
    "log": (write_dumper, [*("q.ankle=legs.1:rad:1", "q.hip=legs.2:rad:1"), *stated_wrench("feet.right")]),
    "log.mcap": (write_ros, []),
}


def dumped(change):
    """Return a function that writes a log with changed rows."""
    return lambda path: write_dumper(path, change)


def retold(edit):
    """Return a function that writes a log with changed lines of the legs."""

    def write(path):
        write_dumper(path)
        file = path / "legs" / "data.log"
        file.write_text("".join(f"{line}\n" for line in edit(file.read_text().splitlines())))

    return write


def in_the_air(device, rows):
    return rows * (1 - (device != "legs") * (np.arange(rows.shape[1]) > 1))


def broken(path):
    path.write_bytes(b"nothing")


NEW_MATLAB = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + b"\x89HDF" * 100
BAD = {
    "clocks that do not overlap": ("log", dumped(lambda device, rows: rows + 100 * (device == "legs"))),
    "a clock that runs backwards": ("log", dumped(lambda device, rows: rows[::-1])),
    "words among numbers": ("log", retold(lambda lines: ["0 1.0 [ok] 2 3"])),
    "a device without samples": ("log", retold(lambda lines: [])),
    "a line that is cut": ("log", retold(lambda lines: [*lines, "501 1000000005"])),
    "an empty folder": ("log", lambda path: path.mkdir()),
    "MATLAB 7.3": ("log.mat", lambda path: path.write_bytes(NEW_MATLAB)),
    "MATLAB without a series": ("log.mat", lambda path: scipy.io.savemat(path, {"gain": 3.0})),
    "no MATLAB file": ("log.mat", broken),
    "no bag": ("log.mcap", broken),
    "a foot in the air all the time": ("log", dumped(in_the_air)),
    "nothing moves": ("log", dumped(lambda name, rows: np.where((name == "legs") & (rows < 2), 0.1, rows))),
}
