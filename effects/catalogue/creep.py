"""A load cell creeps: under a constant load its reading keeps growing.

reading = load + creep, and the creep follows size times the load with one time constant. Real cells need
several exponentials (Bartel and Yaniv 1997 fitted 65 cells). OIML R 60 limits what a reading changes within
30 minutes of loading: the time constants are tens of minutes. The size is one of cheap cells, assumed. The
creep is zero at the first posture. Between two readings the cell bears the mean of their loads. That holds
for the breaks too in which the robot is set down again: they are short against the time constant, so the
recovery of an empty cell is left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.identification.observation import Observation, fraction_of_time
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    cell, forces, size = CELLS.index(target), m.cell_forces.copy(), values[0]
    creep, before = 0.0, 0.0
    for row, kept in _intervals(fraction_of_time(m.time), values[1]):
        load = m.cell_forces[row, cell]
        creep = kept * creep + (1 - kept) * size * (before + load) / 2
        forces[row, cell], before = load + creep, load
    return replace(m, cell_forces=forces)


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    cell, forces, size = CELLS.index(target), observed.cell_forces.copy(), values[0]
    creep, before = 0.0, None
    for row, kept in _intervals(observed.time_fraction, values[1]):
        grown = (1 - kept) * size / 2  # creep by each of the two loads
        reading = forces[row, cell] - kept * creep
        # A part of an experiment begins later: the cell bore its first load until then.
        load = reading / (1 + 2 * grown) if before is None else (reading - grown * before) / (1 + grown)
        creep = observed.cell_forces[row, cell] - load
        forces[row, cell] = before = load
    return observed.changed(cell_forces=forces)


def _intervals(time: np.ndarray, constant: float) -> list[tuple[int, float]]:
    """Return the rows in the order of time, each with the part of the creep kept since the one before.

    Args:
        time: of the postures, as a fraction of the experiment's, (m,).
        constant: time constant, as a fraction of the experiment's time.
    """
    order = np.argsort(time, kind="stable")
    kept = np.exp(-np.diff(time[order], prepend=0.0) / constant)
    return list(zip(order.tolist(), kept.tolist(), strict=True))


EFFECT = Effect(
    name="creep",
    sentence="A load cell's reading grows towards (1 + size) times its load, with a time constant "
    "given as a fraction of the experiment's time.",
    parameters=(
        Parameter("size", "", prior=0.01),
        Parameter("constant", "", grid=(0.03, 0.1, 0.3), smooth=True),
    ),
    mechanism=Misreading(_apply, _undo),
    words="The {target} cell creeps by {0} of its load, with the time constant {1} of the experiment's time.",
    targets=CELL_NAMES,
    instrument="cells",
)
