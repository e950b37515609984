"""A plate lies elsewhere than was recorded, in all placements alike: a wrong mark, a wrong origin.

The right plate's shift times its share of the load is nearly a constant and so absorbed by the torso's
parameters; the left one's too, but for how the share varies.
"""

from __future__ import annotations

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.misrecorded_plates import misrecorded, put_right
from tulip_testbed.effects.targets import PLATE_NAMES
from tulip_testbed.sim.robot import PLATES


def _shift(placement: np.ndarray, target: str, values: Values) -> np.ndarray:
    """True minus recorded pose, (2, 3) [m, m, rad]."""
    shift = np.zeros((2, 3))
    shift[PLATES.index(target), :2] = values
    return shift


EFFECT = Effect(
    name="plate-translation",
    sentence="A plate lies elsewhere than recorded, in every placement by the same way (base frame).",
    parameters=(Parameter("x", "m", prior=0.005), Parameter("y", "m", prior=0.005)),
    inject=misrecorded(_shift),
    predict=put_right(_shift),
    words="The {target} plate lies {0} further forward and {1} further left than recorded.",
    targets=PLATE_NAMES,
    misreads=True,
)
