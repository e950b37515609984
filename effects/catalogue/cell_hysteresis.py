"""The cells remember a part of the last change of load: hysteresis, creep.

reading = true + part (previous true - true). Previous is the row before in the order of time, also where a
posture between them was tried and dropped. Where the robot was put down anew (another placement or
support) the plates were empty before: the previous load is 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import misreading
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.procedure import new_set_up
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        true, before = m.cell_forces, np.zeros_like(m.cell_forces)
        for previous, row in _pairs(m):
            before[row] = true[previous]
        return replace(m, cell_forces=true + values[0] * (before - true))

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    part = values[0]
    true = observed.cell_forces / (1 - part)
    for previous, row in _pairs(observed.measurements):
        true[row] -= part / (1 - part) * true[previous]
    return observed.changed(cell_forces=true)


def _pairs(m: Measurements) -> list[tuple[int, int]]:
    """Rows that followed on another in one set-up, and those others, in the order of time."""
    order = np.argsort(m.time, kind="stable")
    anew = new_set_up(m.placement[order], m.support[order])
    return [
        (int(previous), int(row))
        for previous, row, apart in zip(order[:-1], order[1:], anew, strict=True)
        if not apart
    ]


EFFECT = Effect(
    name="cell-hysteresis",
    sentence="The cells keep a part of the last change of their load.",
    parameters=(Parameter("part", "", prior=0.01),),
    inject=_inject,
    predict=_predict,
    words="The cells keep {0} of the last change of their load.",
    misreads=True,
)
