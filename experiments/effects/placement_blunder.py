"""One placement's pose of the left plate is written down wrong: a slip of the pen, a tape misread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.effects.effect import Effect, Parameter, Values
from experiments.effects.injection import misreading
from experiments.effects.seen import Seen
from experiments.effects.targets import PLACEMENTS
from sim.measurements import Measurements
from sim.model import PLATES
from sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(m, plate_poses=m.plate_poses - _shift(m.placement, target, values))

    return misreading(rig, read)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    shift = _shift(seen.measurements.placement, target, values)
    return seen.changed(plate_poses=seen.plate_poses + shift)


def _shift(placement: np.ndarray, target: str, values: Values) -> np.ndarray:
    """True minus recorded poses, (m, 2, 3) [m, m, rad]."""
    shift = np.zeros((len(placement), 2, 3))
    shift[placement == int(target), PLATES.index("left"), :2] = values
    return shift


EFFECT = Effect(
    name="placement-blunder",
    sentence="The left plate's pose of one placement is recorded wrong (base frame).",
    parameters=(Parameter("x", "m", prior=0.01), Parameter("y", "m", prior=0.01)),
    inject=_inject,
    predict=_predict,
    words="In placement {target} the left plate lies {0} further forward and {1} further left than recorded.",
    targets=PLACEMENTS,
)
