"""A plate is turned against its recorded pose, about its middle, in all placements alike."""

from __future__ import annotations

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.misrecorded_plates import misrecorded, put_right
from tulip_testbed.effects.targets import PLATE_NAMES
from tulip_testbed.sim.robot import PLATES


def _shift(placement: np.ndarray, target: str, values: Values) -> np.ndarray:
    """True minus recorded pose, (2, 3) [m, m, rad]."""
    shift = np.zeros((2, 3))
    shift[PLATES.index(target), 2] = values[0]
    return shift


EFFECT = Effect(
    name="plate-yaw",
    sentence="A plate is turned against its recorded pose, in every placement alike.",
    parameters=(Parameter("yaw", "rad", prior=np.radians(1.0)),),
    inject=misrecorded(_shift),
    predict=put_right(_shift),
    words="The {target} plate is turned by {0} (to the left) against its recorded pose.",
    targets=PLATE_NAMES,
    misreads=True,
)
