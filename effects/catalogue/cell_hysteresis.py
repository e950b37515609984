"""The load cells lag behind their load: hysteresis or creep.

reading = load + fraction (previous load - load). The previous load is that of the preceding row in the order
of time, even if a posture was tried in between and dropped. Where the robot was set down again (another
placement or support) the plates were empty before, so the previous load is 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import successive
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    load, before = m.cell_forces, np.zeros_like(m.cell_forces)
    for previous, row in successive(m):
        before[row] = load[previous]
    return replace(m, cell_forces=load + values[0] * (before - load))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    fraction = values[0]
    load = observed.cell_forces / (1 - fraction)
    for previous, row in successive(observed.measurements):
        load[row] -= fraction / (1 - fraction) * load[previous]
    return observed.changed(cell_forces=load)


EFFECT = Effect(
    name="cell-hysteresis",
    sentence="The cells lag behind by a fraction of the last change of their load.",
    parameters=(Parameter("part", "", prior=0.01),),
    mechanism=Misreading(_apply, _undo),
    words="The cells lag behind by {0} of the last change of their load.",
    instrument="cells",
)
