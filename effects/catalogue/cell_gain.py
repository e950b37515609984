"""One load cell's calibration is off: it reads a multiple of what it bears."""

from __future__ import annotations

from dataclasses import replace

from effects.effect import Effect, Parameter, Values
from effects.injection import column, misreading
from effects.targets import CELL_NAMES
from identification.observation import Observation
from sim.measurements import Measurements
from sim.rig import Rig
from sim.robot import CELLS


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
