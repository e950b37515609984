"""One load cell's calibration is off: it reads a multiple of what it bears."""

from __future__ import annotations

from dataclasses import replace

from experiments.effects.effect import Effect, Parameter, Values
from experiments.effects.injection import column, misreading
from experiments.effects.seen import Seen
from experiments.effects.targets import CELL_NAMES
from sim.measurements import Measurements
from sim.model import CELLS
from sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        factor = 1 + values[0] * column(CELLS, target, len(CELLS))
        return replace(m, cell_forces=m.cell_forces * factor)

    return misreading(rig, read)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    factor = 1 + values[0] * column(CELLS, target, len(CELLS))
    return seen.changed(cell_forces=seen.cell_forces / factor)


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
