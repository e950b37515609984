"""The load cells of a plate influence each other: they share an excitation, or the plate bends.

Each cell reads its own load and this fraction of the loads on the other three cells of its plate. The sum
of the cells grows by three times the fraction, and the centre of pressure of each foot is drawn towards the
centre of its plate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    plates = m.cell_forces.reshape(-1, 2, 4)
    return replace(m, cell_forces=(plates @ _mixing(values)).reshape(-1, 8))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    plates = observed.cell_forces.reshape(-1, 2, 4)
    return observed.changed(cell_forces=(plates @ np.linalg.inv(_mixing(values))).reshape(-1, 8))


def _mixing(values: Values) -> np.ndarray:
    """Return the readings of a plate's cells per load on each, (4, 4), symmetric."""
    return (1 - values[0]) * np.eye(4) + values[0]


EFFECT = Effect(
    name="cell-crosstalk",
    sentence="Every cell also reads a fraction of the loads on the other three cells of its plate.",
    parameters=(Parameter("crosstalk", "", prior=0.02),),
    mechanism=Misreading(_apply, _undo),
    words="Every cell also reads {0} of the loads on the other three cells of its plate.",
    instrument="cells",
)
