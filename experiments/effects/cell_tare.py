"""One load cell's zero is off: it reads a constant force too much.

The sum of the cells shows it against the weighed mass; what it shifts of the centre of pressure is
nearly constant and so absorbed.
"""

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
        return replace(m, cell_forces=m.cell_forces + values[0] * column(CELLS, target, len(CELLS)))

    return misreading(rig, read)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    return seen.changed(cell_forces=seen.cell_forces - values[0] * column(CELLS, target, len(CELLS)))


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
