"""Two load cells of a plate are swapped: each is connected to the other's channel.

There is no size to estimate. A search tries all pairs of the two grids: the six different pairs, and three
that change nothing or repeat another pair.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import PLATE_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CORNERS, PLATES


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, cell_forces=_swapped(m.cell_forces, target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=_swapped(observed.cell_forces, target, values))


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
    mechanism=Misreading(_apply, _undo),
    words="The {0} and {1} cells of the {target} plate are swapped.",
    targets=PLATE_NAMES,
    instrument="cells",
)
