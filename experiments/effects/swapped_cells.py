"""Two cells of a plate are swapped: plugged into each other's channel.

There is no size to estimate: a search tries the pairs of the two grids, six different ones and three
that change nothing or come twice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.effects.effect import Effect, Parameter, Values
from experiments.effects.injection import misreading
from experiments.effects.seen import Seen
from experiments.effects.targets import PLATE_NAMES
from sim.measurements import Measurements
from sim.model import CORNERS, PLATES
from sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(m, cell_forces=_swapped(m.cell_forces, target, values))

    return misreading(rig, read)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    return seen.changed(cell_forces=_swapped(seen.cell_forces, target, values))


def _swapped(forces: np.ndarray, target: str, values: Values) -> np.ndarray:
    columns = np.arange(forces.shape[1])
    pair = len(CORNERS) * PLATES.index(target) + np.array(values, dtype=int)
    columns[pair] = pair[::-1]
    return forces[:, columns]


EFFECT = Effect(
    name="swapped-cells",
    sentence="Two cells of a plate are swapped.",
    parameters=(
        Parameter("first", "", grid=(0, 1, 2), choices=CORNERS),
        Parameter("second", "", grid=(1, 2, 3), choices=CORNERS),
    ),
    inject=_inject,
    predict=_predict,
    words="The {0} and {1} cells of the {target} plate are swapped.",
    targets=PLATE_NAMES,
    misreads=True,
)
