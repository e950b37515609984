"""A plate is turned against its recorded pose, about its middle, in all placements alike."""

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
        return replace(m, plate_poses=m.plate_poses - _turn(target, values))

    return misreading(rig, read)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    return seen.changed(plate_poses=seen.plate_poses + _turn(target, values))


def _turn(target: str, values: Values) -> np.ndarray:
    """True minus recorded pose, (2, 3) [m, m, rad]."""
    turn = np.zeros((2, 3))
    turn[PLATES.index(target), 2] = values[0]
    return turn


EFFECT = Effect(
    name="plate-yaw",
    sentence="A plate is turned against its recorded pose, in every placement alike.",
    parameters=(Parameter("yaw", "rad", prior=np.radians(1.0)),),
    inject=_inject,
    predict=_predict,
    words="The {target} plate is turned by {0} (to the left) against its recorded pose.",
    targets=PLATE_NAMES,
)
