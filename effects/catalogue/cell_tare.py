"""One load cell's zero is off: it reads a constant force too much.

The sum of the cells shows it against the weighed mass; what it shifts of the centre of pressure is
nearly constant and so absorbed.
"""

from __future__ import annotations

from dataclasses import replace

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import column, misreading
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import CELLS


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(m, cell_forces=m.cell_forces + values[0] * column(CELLS, target, len(CELLS)))

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces - values[0] * column(CELLS, target, len(CELLS)))


EFFECT = Effect(
    name="cell-tare",
    sentence="A load cell reads a constant force more than it bears.",
    parameters=(Parameter("tare", "N", prior=1.0),),
    inject=_inject,
    predict=_predict,
    words="The {target} cell reads {0} too much at any load.",
    targets=CELL_NAMES,
    misreads=True,
)
