"""One placement's pose of the left plate is written down wrong: a slip of the pen, a tape misread."""

from __future__ import annotations

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.misrecorded_plates import misrecorded, put_right
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.sim.robot import PLATES


def _shift(placement: np.ndarray, target: str, values: Values) -> np.ndarray:
    """True minus recorded poses, (m, 2, 3) [m, m, rad]."""
    shift = np.zeros((len(placement), 2, 3))
    shift[placement == int(target), PLATES.index("left"), :2] = values
    return shift


EFFECT = Effect(
    name="placement-blunder",
    sentence="The left plate's pose of one placement is recorded wrong (base frame).",
    parameters=(Parameter("x", "m", prior=0.01), Parameter("y", "m", prior=0.01)),
    inject=misrecorded(_shift),
    predict=put_right(_shift),
    words="In placement {target} the left plate lies {0} further forward and {1} further left than recorded.",
    targets=PLACEMENTS,
    misreads=True,
)
