"""The zeros of a plate's four cells drift together: they share an amplifier and a temperature.

One rate for all four: what the cells have in common moves the sum of the forces four times as much as one
cell would, leaves the twist of the board as it is, and pulls the centre of pressure to that plate's centre.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import indicator
from tulip_testbed.effects.targets import PLATE_NAMES
from tulip_testbed.identification.observation import Observation, fraction_of_time
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CORNERS, PLATES


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, cell_forces=m.cell_forces + _error(fraction_of_time(m.time), target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces - _error(observed.time_fraction, target, values))


def _error(time: np.ndarray, target: str, values: Values) -> np.ndarray:
    """Return reading minus force, (m, 8) [N].

    Args:
        time: of the postures, as a fraction of the experiment's, (m,).
    """
    return values[0] * np.outer(time, np.repeat(indicator(PLATES, target), len(CORNERS)))


EFFECT = Effect(
    name="plate-drift",
    sentence="The zeros of a plate's four cells drift steadily, each from 0 at the first posture to this "
    "at the last.",
    parameters=(Parameter("drift", "N", prior=1.0),),
    mechanism=Misreading(_apply, _undo),
    words="The zeros of all cells of the {target} plate drift by {0} each over the experiment.",
    targets=PLATE_NAMES,
    instrument="cells",
)
