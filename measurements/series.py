"""The optional raw series: all samples of all windows in one long table."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tulip_testbed.base.files import present
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.measurements.checked_table import checked_table
from tulip_testbed.measurements.data import Measurements
from tulip_testbed.measurements.measurement_folder import read_manifest

MOST_SAMPLES = 5_000_000


@dataclass(frozen=True)
class Series:
    """Raw readings, one row per sample.

    Attributes:
        posture: posture number, (n,).
        t: time on the same clock as `Measurements.time`, (n,) [s].
        readings: joint angles, then cell forces in the order of `CELLS`, (n, n_joints + 8) [rad, N].
    """

    posture: np.ndarray
    t: np.ndarray
    readings: np.ndarray

    def window(self, measurements: Measurements, row: int) -> np.ndarray:
        """Return the samples of a row of the measurements in time order, (k, n_joints + 8).

        Without a time or a window in the row, these are all samples of the posture.
        """
        inside = self.posture == measurements.posture[row]
        start, length = measurements.time[row], measurements.window[row]
        if np.isfinite(start) and np.isfinite(length):
            inside &= (self.t >= start) & (self.t <= start + length)
        chosen = np.flatnonzero(inside)
        return self.readings[chosen[np.argsort(self.t[chosen], kind="stable")]]


def read_series(folder: Path) -> Series | None:
    """Read series.parquet (or series.csv) of a measurement folder of version 1; None without one."""
    folder = Path(folder)
    if not any(present(folder / f"series.{suffix}") for suffix in ("parquet", "csv")):
        return None
    manifest = read_manifest(folder)
    if manifest.contacts is not None:
        return None
    table = checked_table(folder, "series", manifest.tables, MOST_SAMPLES)
    return Series(
        posture=table.integers("posture"),
        t=table.numbers("t"),
        readings=np.hstack([table.matrix("q", tuple(manifest.joints)), table.matrix("cell", CELLS)]),
    )
