"""Motions as files: CSV, and ROS 2's trajectory_msgs/JointTrajectory as YAML."""

from __future__ import annotations

import io

import numpy as np
import yaml

from tulip_testbed.experiments.protocols.motion import FREE, STRIDE, Motion

DIGITS = 6  # of an angle [rad], its derivatives and a torque


def motion_csv(motion: Motion, joints: tuple[str, ...]) -> str:
    """Return a motion as CSV: time [s], then q, qd, qdd and torque of every joint [rad, s, N m].

    In the hoist, which carries an unknown part of the robot, there are no torques.
    """
    groups = [("q", motion.angles), ("qd", motion.speeds), ("qdd", motion.accelerations)]
    groups += [("torque", motion.torques)] if motion.kind == FREE else []
    header = ",".join(["time", *(f"{name}.{joint}" for name, _ in groups for joint in joints)])
    out = io.StringIO()
    table = np.column_stack([motion.times, *(values for _, values in groups)])
    np.savetxt(out, _rounded(table), fmt=f"%.{DIGITS}f", delimiter=",", header=header, comments="")
    return out.getvalue()


def motion_yaml(motion: Motion, joints: tuple[str, ...]) -> str:
    """Return a motion as a JointTrajectory message; quintic splines between its points follow the motion."""
    points = []
    for k in range(0, len(motion.times), STRIDE):
        nanoseconds = round(float(motion.times[k]) * 1e9)
        points.append(
            {
                "positions": _rounded(motion.angles[k]).tolist(),
                "velocities": _rounded(motion.speeds[k]).tolist(),
                "accelerations": _rounded(motion.accelerations[k]).tolist(),
                "effort": _rounded(motion.torques[k]).tolist() if motion.kind == FREE else [],
                "time_from_start": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
            }
        )
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(joints),
        "points": points,
    }
    return yaml.dump(message, Dumper=yaml.CSafeDumper, sort_keys=False, default_flow_style=None, width=10**6)


def motion_name(number: int, motion: Motion) -> str:
    """Return the name of a motion's files without ending: its number in the order and both postures."""
    return f"{number:03d}-from-{motion.start}-to-{motion.end}"


def _rounded(values: np.ndarray) -> np.ndarray:
    return np.round(values, DIGITS) + 0.0  # no minus zero
