"""The optional raw series: every sample of every window, in one long table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tulip_testbed.sim.files import present
from tulip_testbed.sim.measurements.data import Measurements
from tulip_testbed.sim.measurements.measurement_folder import read_manifest
from tulip_testbed.sim.measurements.table_files import checked_table
from tulip_testbed.sim.robot import CELLS

MOST_SAMPLES = 5_000_000


@dataclass(frozen=True)
class Series:
    """Raw readings, one row per sample.

    Attributes:
        posture: number, (n,).
        t: on the clock of the table's `time`, (n,) [s].
        readings: joint angles, then cell forces in the order of `CELLS`, (n, n_joints + 8) [rad, N].
    """

    posture: np.ndarray
    t: np.ndarray
    readings: np.ndarray

    def window(self, measurements: Measurements, row: int) -> np.ndarray:
        """The samples behind a row of the table, in the order of time, (k, n_joints + 8).

        All of the posture's where the row gives no time or no window.
        """
        inside = self.posture == measurements.posture[row]
        start, length = measurements.time[row], measurements.window[row]
        if np.isfinite(start) and np.isfinite(length):
            inside &= (self.t >= start) & (self.t <= start + length)
        chosen = np.flatnonzero(inside)
        return self.readings[chosen[np.argsort(self.t[chosen], kind="stable")]]


def read_series(folder: Path) -> Series | None:
    """Read series.parquet (or series.csv) of a measurement folder; None where there is none.

    Raises:
        InputError: not what the manifest lists, a missing column, a value that is no number.
    """
    folder = Path(folder)
    if not any(present(folder / f"series.{suffix}") for suffix in ("parquet", "csv")):
        return None
    manifest = read_manifest(folder)
    table = checked_table(folder, "series", manifest.tables, MOST_SAMPLES)
    return Series(
        posture=table.integers("posture"),
        t=table.numbers("t"),
        readings=np.hstack([table.matrix("q", tuple(manifest.joints)), table.matrix("cell", CELLS)]),
    )
