"""A plate is displaced from its recorded position, by the same vector in all placements.

A wrong mark or origin does this. The centre of pressure shifts by the displacement times the plate's share
of the load. For the right plate this is nearly constant, so the torso's parameters absorb it; for the left
plate too, apart from the variation of its share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import PLATE_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, plate_poses=m.plate_poses - _displacement(target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(plate_poses=observed.plate_poses + _displacement(target, values))


def _displacement(target: str, values: Values) -> np.ndarray:
    """Return true minus recorded poses, (2, 3) [m, m, rad]."""
    displacement = np.zeros((2, 3))
    displacement[PLATES.index(target), :2] = values
    return displacement


EFFECT = Effect(
    name="plate-translation",
    sentence="A plate is displaced from its recorded position, equally in every placement (base frame).",
    parameters=(Parameter("x", "m", prior=0.005), Parameter("y", "m", prior=0.005)),
    mechanism=Misreading(_apply, _undo),
    words="The {target} plate lies {0} further forward and {1} further left than recorded.",
    targets=PLATE_NAMES,
)
