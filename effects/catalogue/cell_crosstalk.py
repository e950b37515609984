"""The cells of a plate read a part of each other: shared excitation, a board bent by its load.

Each cell reads itself and this part of the sum of the three others of its plate. It raises the sum of the
cells by three times that part and draws each foot's centre of pressure to its plate's middle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import misreading
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        plates = m.cell_forces.reshape(-1, 2, 4)
        return replace(m, cell_forces=(plates @ _mixing(values)).reshape(-1, 8))

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    plates = observed.cell_forces.reshape(-1, 2, 4)
    return observed.changed(cell_forces=(plates @ np.linalg.inv(_mixing(values))).reshape(-1, 8))


def _mixing(values: Values) -> np.ndarray:
    """What the four cells of a plate read of each other, (4, 4), symmetric."""
    return (1 - values[0]) * np.eye(4) + values[0]


EFFECT = Effect(
    name="cell-crosstalk",
    sentence="Every cell reads also a part of the sum of the other three cells of its plate.",
    parameters=(Parameter("crosstalk", "", prior=0.02),),
    inject=_inject,
    predict=_predict,
    words="Every cell reads also {0} of what the other cells of its plate bear.",
    misreads=True,
)
