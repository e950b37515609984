"""One load cell's calibration is off: it reads a multiple of what it bears."""

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
        factor = 1 + values[0] * column(CELLS, target, len(CELLS))
        return replace(m, cell_forces=m.cell_forces * factor)

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    factor = 1 + values[0] * column(CELLS, target, len(CELLS))
    return observed.changed(cell_forces=observed.cell_forces / factor)


EFFECT = Effect(
    name="cell-gain",
    sentence="A load cell reads (1 + gain) times what it bears.",
    parameters=(Parameter("gain", "", prior=0.05),),
    inject=_inject,
    predict=_predict,
    words="The {target} cell reads {0} too much.",
    targets=CELL_NAMES,
    misreads=True,
)
