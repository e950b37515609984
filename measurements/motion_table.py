"""The table of a robot that moves: one row per sample, in segments without interruption."""

from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.table_files import refuse_rows
from tulip_testbed.measurements.data import OF_WRENCHES, Measurements
from tulip_testbed.measurements.trajectory import runs

MOTION, SEGMENT = "motion", "segment"  # name of the table; of the column that `Measurements.posture` holds
MOST_SAMPLES = 500_000
LEAST_RATE, MOST_RATE = 20.0, 10_000.0  # Hz
NOT_OF_SAMPLES = (
    "window",
    "samples",
    "q_std",
    "cell_std",
    "q_rate",
    "q_acceleration",
    *list(OF_WRENCHES)[1:],
)


def motion_columns(samples: Measurements) -> dict[str, np.ndarray]:
    """Return samples as the columns of their table; what only a window has is left out."""
    columns = {SEGMENT: samples.posture} | samples.columns()
    return {
        name: values
        for name, values in columns.items()
        if name != "posture" and name.partition(".")[0] not in NOT_OF_SAMPLES
    }


def check_segments(
    where: Path | str, time: np.ndarray, segment: np.ndarray, placement: np.ndarray, support: np.ndarray
) -> None:
    """Refuse a clock [s] that does not run forward, and segments that are not one motion on one stance."""

    def refuse(rows: np.ndarray, name: str, values: np.ndarray, expected: str) -> None:
        if rows.any():
            row = int(rows.argmax())
            found = f"{values[row]} after {values[row - 1]}" if within[row] else f"{values[row]}"
            raise InputError(f"{where}: column '{name}', row {row + 1}: found {found}, expected {expected}")

    within = np.append(False, segment[1:] == segment[:-1])
    begins = [rows.start for rows in runs(segment)]
    _, first = np.unique(segment[begins], return_index=True)
    again = np.zeros(len(segment), bool)
    again[np.delete(begins, first)] = True
    refuse(again, SEGMENT, segment, "the rows of a segment one after the other")
    refuse_rows(where, "time", ~np.isfinite(time), time, "a finite number")
    backward = within & np.append(False, np.diff(time) <= 0)
    refuse(backward, "time", time, "a time that increases within a segment")
    for name, values in (("placement", placement), ("support", support)):
        other = within & np.append(False, values[1:] != values[:-1])
        refuse(other, name, values, f"one {name} in a segment; begin a new one")
