"""Read the text logs of a dumper: a folder for each device, `data.log` with lines `index time v1 v2 ...`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import read_bytes
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements.logs.joined_clocks import Device, joined_devices

DATA = "data.log"
PLAIN = bytes.maketrans(b"()", b"  ")  # a dumper writes lists in brackets


def read_dumper(folder: Path, files: Sequence[Path]) -> TableFile:
    """Read the devices of a folder, joined by time.

    Columns are DEVICE.1, DEVICE.2, ..., the device being named after its folder.
    """
    return joined_devices(folder, [_device(folder, file) for file in files])


def _device(folder: Path, file: Path) -> Device:
    name = ".".join(file.parent.relative_to(folder).parts) or folder.name
    content = read_bytes(file).translate(PLAIN)
    try:
        numbers = np.loadtxt(io.BytesIO(content), ndmin=2)
    except ValueError as error:
        raise InputError(
            f"{file}: {shortened(error, 120)}; expected lines `index time v1 v2 ...` of numbers alone"
        ) from None
    if numbers.shape[1] < 3:
        raise InputError(f"{file}: found {numbers.shape[1]} numbers a line, expected `index time v1 v2 ...`")
    columns = tuple(f"{name}.{k}" for k in range(1, numbers.shape[1] - 1))
    return Device(name, numbers[:, 1], columns, numbers[:, 2:])
