"""The gain of all load cells drifts steadily: the amplifier or the cells warm up.

A gain that is the same in all cells does not move the centre of pressure; only the sum of the cells shows it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.identification.observation import Observation, fraction_of_time
from tulip_testbed.measurements import Measurements


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, cell_forces=m.cell_forces * _factor(fraction_of_time(m.time), values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces / _factor(observed.time_fraction, values))


def _factor(time: np.ndarray, values: Values) -> np.ndarray:
    """Return reading over force, (m, 1).

    Args:
        time: of the postures, as a fraction of the experiment's, (m,).
    """
    return 1 + values[0] * time[:, None]


EFFECT = Effect(
    name="thermal-gain-drift",
    sentence="The gain of all cells grows steadily, from 1 at the first posture to 1 + gain at the last.",
    parameters=(Parameter("gain", "", prior=0.01),),
    mechanism=Misreading(_apply, _undo),
    words="The gain of all cells drifts by {0} over the experiment.",
    instrument="cells",
)
