"""A plate lies elsewhere than was recorded, in all placements alike: a wrong mark, a wrong origin.

The right plate's shift times its share of the load is nearly a constant and so absorbed by the torso's
parameters; the left one's too, but for how the share varies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.effects.effect import Effect, Parameter, Values
from experiments.effects.injection import misreading
from experiments.effects.seen import Seen
from experiments.effects.targets import PLATE_NAMES
from sim.measurements import Measurements
from sim.model import PLATES
from sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(m, plate_poses=m.plate_poses - _shift(target, values))

    return misreading(rig, read)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    return seen.changed(plate_poses=seen.plate_poses + _shift(target, values))


def _shift(target: str, values: Values) -> np.ndarray:
    """True minus recorded pose, (2, 3) [m, m, rad]."""
    shift = np.zeros((2, 3))
    shift[PLATES.index(target), :2] = values
    return shift


EFFECT = Effect(
    name="plate-translation",
    sentence="A plate lies elsewhere than recorded, in every placement by the same way (base frame).",
    parameters=(Parameter("x", "m", prior=0.005), Parameter("y", "m", prior=0.005)),
    inject=_inject,
    predict=_predict,
    words="The {target} plate lies {0} further forward and {1} further left than recorded.",
    targets=PLATE_NAMES,
)
