"""A load cell's zero drifts steadily: the cell was tared at the start of the experiment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import indicator
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.identification.observation import Observation, fraction_of_time
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, cell_forces=m.cell_forces + _error(fraction_of_time(m.time), target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces - _error(observed.time_fraction, target, values))


def _error(time: np.ndarray, target: str, values: Values) -> np.ndarray:
    """Return reading minus force, (m, 8) [N].

    Args:
        time: of the postures, as a fraction of the experiment's, (m,).
    """
    return values[0] * np.outer(time, indicator(CELLS, target))


EFFECT = Effect(
    name="cell-drift",
    sentence="A load cell's zero drifts steadily, from 0 at the first posture to this at the last.",
    parameters=(Parameter("drift", "N", prior=2.0),),
    mechanism=Misreading(_apply, _undo),
    words="The zero of the {target} cell drifts by {0} over the experiment.",
    targets=CELL_NAMES,
    instrument="cells",
)
