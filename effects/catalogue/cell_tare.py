"""A load cell reads a constant force too much: its zero is wrong.

The sum of the cells shows the error against the weighed mass. The shift of the centre of pressure is
nearly the same in all postures, so the base parameters absorb it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import indicator
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, cell_forces=m.cell_forces + _error(target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces - _error(target, values))


def _error(target: str, values: Values) -> np.ndarray:
    """Return reading minus force, (8,) [N]."""
    return values[0] * indicator(CELLS, target)


EFFECT = Effect(
    name="cell-tare",
    sentence="A load cell reads a constant force too much.",
    parameters=(Parameter("tare", "N", prior=1.0),),
    mechanism=Misreading(_apply, _undo),
    words="The {target} cell reads {0} too much at any load.",
    targets=CELL_NAMES,
    instrument="cells",
)
