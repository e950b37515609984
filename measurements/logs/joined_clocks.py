"""Join devices that were logged by clocks of their own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError, warn
from tulip_testbed.base.table_files import TableFile

TIME = "time [s]"  # column of a joined log
GAP = 5.0  # periods without a sample, between which nothing is interpolated
STOPS = 1.0  # s that a device ends before the others, of which the user is told


@dataclass(frozen=True, eq=False)
class Device:
    """One device of a log.

    Attributes:
        name: for messages. time: (n,) [s]. columns: names of its values. values: (n, k).
    """

    name: str
    time: np.ndarray
    columns: tuple[str, ...]
    values: np.ndarray


def joined_devices(path: Path, devices: Sequence[Device]) -> TableFile:
    """Interpolate all devices on the slowest one's clock, where all were logged and none has a gap."""
    new = [in_order(f"{path}: {device.name}", device.time) for device in devices]
    devices = [replace(d, time=d.time[k], values=d.values[k]) for d, k in zip(devices, new, strict=True)]
    first, last = (max(devices, key=lambda d: d.time[0]), min(devices, key=lambda d: d.time[-1]))
    start, end = first.time[0], last.time[-1]
    if start >= end:
        raise InputError(
            f"{path}: found clocks that do not overlap: {last.name} ends at {end:.10g} s and {first.name} "
            f"begins at {start:.10g} s; expected devices logged at the same time by one clock"
        )
    if (rest := max(device.time[-1] for device in devices) - end) > STOPS:
        warn(f"{path}: {last.name} stops {rest:.3g} s before the others; only what it has seen is used")
    slowest = max(devices, key=_period)
    clock = slowest.time[(slowest.time >= start) & (slowest.time <= end)]
    for device in devices:
        clock = clock[~_in_gap(device, clock)]
    if not len(clock):
        raise InputError(f"{path}: found no time at which all devices were logged, expected one clock")
    columns = {TIME: clock}
    for device in devices:
        for k, name in enumerate(device.columns):
            columns[name] = np.interp(clock, device.time, device.values[:, k])
    return TableFile.of_columns(path, columns)


def in_order(where: str, time: np.ndarray) -> np.ndarray:
    """Return which of the times are new, (n,) bool: the first of samples with the same time counts."""
    steps = np.diff(time)
    if len(time) < 2 or not np.isfinite(time).all():
        raise InputError(f"{where}: found times that are fewer than two or no numbers")
    if (steps < 0).any():
        k = int((steps < 0).argmax())
        raise InputError(f"{where}: found a clock that runs backwards by {-steps[k]:.3g} s at sample {k + 2}")
    return np.append(True, steps > 0)


def _period(device: Device) -> float:
    return float(np.median(np.diff(device.time)))


def _in_gap(device: Device, clock: np.ndarray) -> np.ndarray:
    """Return which times lie between two samples that are too far apart, (n,) bool."""
    after = np.clip(np.searchsorted(device.time, clock), 1, len(device.time) - 1)
    far = device.time[after] - device.time[after - 1] > GAP * _period(device)
    return far & (clock > device.time[after - 1]) & (clock < device.time[after])
