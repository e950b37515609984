"""A plate is rotated about its centre from its recorded pose, by the same angle in all placements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import PLATE_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, plate_poses=m.plate_poses - _rotation(target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(plate_poses=observed.plate_poses + _rotation(target, values))


def _rotation(target: str, values: Values) -> np.ndarray:
    """Return true minus recorded poses, (2, 3) [m, m, rad]."""
    rotation = np.zeros((2, 3))
    rotation[PLATES.index(target), 2] = values[0]
    return rotation


EFFECT = Effect(
    name="plate-yaw",
    sentence="A plate is rotated from its recorded pose, equally in every placement.",
    parameters=(Parameter("yaw", "rad", prior=np.radians(1.0)),),
    mechanism=Misreading(_apply, _undo),
    words="The {target} plate is rotated by {0} (to the left) from its recorded pose.",
    targets=PLATE_NAMES,
)
