"""How a log may name, sign and count joint angles otherwise than the robot's file, and be late."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from tulip_testbed.measurements import Measurements

TURNS = ("roll", "pitch", "yaw")
OUTSIDE = np.radians(10.0)  # of a joint's range, that a reading may be
APART = np.radians(3.0)  # a range so nearly symmetric has no wrong end
OF_ANGLES = ("joint_angles", "joint_rates", "joint_accelerations")


def other_readings(measurements: Measurements, joint_range: np.ndarray) -> Iterator[tuple[str, Measurements]]:
    """Yield what the joints' columns may mean instead, and the measurements if so.

    These are another sign, a zero at the other end of the range, and another order of the roll, pitch and
    yaw of one place. Readings outside a joint's range, (n_joints, 2) [rad], are left out.
    """
    m, joints = measurements, measurements.joints
    logged = [k for k, joint in enumerate(joints) if joint not in m.constant_joints]
    for k in logged:
        ends = joint_range[k].sum()
        turned = [(f"{joints[k]}: sign turned", 0.0)]
        if np.isfinite(ends) and abs(ends) > APART:
            turned.append((f"{joints[k]}: counted from the other end of its range", ends))
        for what, zero in turned:
            factor = np.where(np.arange(len(joints)) == k, -1.0, 1.0)
            yield from _possible(what, _read(m, factor, np.arange(len(joints)), k, zero), joint_range)
    groups: dict[str, list[int]] = {}
    for k in logged:
        if any(turn in joints[k] for turn in TURNS):
            stem = joints[k]
            for turn in TURNS:
                stem = stem.replace(turn, "*")
            groups.setdefault(stem, []).append(k)
    for group in groups.values():
        for order in itertools.permutations(group):
            if list(order) != group:
                source = np.arange(len(joints))
                source[group] = order
                names = ", ".join(joints[k] for k in group)
                what = f"{names}: read in the order {', '.join(joints[k] for k in order)}"
                yield from _possible(what, _read(m, np.ones(len(joints)), source, 0, 0.0), joint_range)


def _read(m: Measurements, factor: np.ndarray, source: np.ndarray, joint: int, zero: float) -> Measurements:
    read = {
        name: None if (values := getattr(m, name)) is None else factor * values[:, source]
        for name in OF_ANGLES
    }
    angles = read["joint_angles"]
    assert angles is not None
    angles[:, joint] += zero
    rates, accelerations = read["joint_rates"], read["joint_accelerations"]
    return replace(m, joint_angles=angles, joint_rates=rates, joint_accelerations=accelerations)


def _possible(what: str, m: Measurements, joint_range: np.ndarray) -> Iterator[tuple[str, Measurements]]:
    low, high = joint_range.T
    if (m.joint_angles > low - OUTSIDE).all() and (m.joint_angles < high + OUTSIDE).all():
        yield what, m


def shifted(wrench: np.ndarray, time: np.ndarray, lag: float) -> np.ndarray:
    """Return rows of a total wrench, (m, 6), as they were a lag later, by the rising times of the rows."""
    return CubicSpline(time, wrench)(np.clip(time + lag, time[0], time[-1]))
