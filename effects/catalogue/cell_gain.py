"""A load cell reads a multiple of its load: its calibration is wrong."""

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
    return replace(m, cell_forces=m.cell_forces * _factor(target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces / _factor(target, values))


def _factor(target: str, values: Values) -> np.ndarray:
    """Return reading over force, (8,)."""
    return 1 + values[0] * indicator(CELLS, target)


EFFECT = Effect(
    name="cell-gain",
    sentence="A load cell reads (1 + gain) times its load.",
    parameters=(Parameter("gain", "", prior=0.05),),
    mechanism=Misreading(_apply, _undo),
    words="The {target} cell reads {0} too much.",
    targets=CELL_NAMES,
    instrument="cells",
)
