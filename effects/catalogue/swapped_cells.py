"""Two cells of a plate are swapped: plugged into each other's channel.

There is no size to estimate: a search tries the pairs of the two grids, six different ones and three
that change nothing or come twice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import misreading
from tulip_testbed.effects.targets import PLATE_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import CORNERS, PLATES


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(m, cell_forces=_swapped(m.cell_forces, target, values))

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
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
    inject=_inject,
    predict=_predict,
    words="The {0} and {1} cells of the {target} plate are swapped.",
    targets=PLATE_NAMES,
    misreads=True,
)
