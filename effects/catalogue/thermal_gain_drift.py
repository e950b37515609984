"""All cells' gain drifts evenly over the experiment: the amplifier or the cells warm up.

Alike in all cells it moves no centre of pressure; only the sum of the cells shows it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import misreading
from tulip_testbed.identification.observation import Observation, time_fraction
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(m, cell_forces=m.cell_forces * _factor(time_fraction(m.time), values))

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces / _factor(observed.part, values))


def _factor(part: np.ndarray, values: Values) -> np.ndarray:
    """Gain of all cells, (m, 1)."""
    return 1 + values[0] * part[:, None]


EFFECT = Effect(
    name="thermal-gain-drift",
    sentence="The gain of all cells grows evenly, from 1 at the first posture to 1 + this at the last.",
    parameters=(Parameter("gain", "", prior=0.01),),
    inject=_inject,
    predict=_predict,
    words="The gain of all cells drifts by {0} over the experiment.",
    misreads=True,
)
