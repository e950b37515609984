"""The position of the left plate is recorded wrong in one placement: a misread tape or a slip of the pen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, plate_poses=m.plate_poses - _displacement(m.placement, target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    displacement = _displacement(observed.measurements.placement, target, values)
    return observed.changed(plate_poses=observed.plate_poses + displacement)


def _displacement(placement: np.ndarray, target: str, values: Values) -> np.ndarray:
    """Return true minus recorded poses, (m, 2, 3) [m, m, rad].

    Args:
        placement: number of each posture's placement, (m,).
    """
    displacement = np.zeros((len(placement), 2, 3))
    displacement[placement == int(target), PLATES.index("left"), :2] = values
    return displacement


EFFECT = Effect(
    name="placement-blunder",
    sentence="The left plate's position is recorded wrong in one placement (base frame).",
    parameters=(Parameter("x", "m", prior=0.01), Parameter("y", "m", prior=0.01)),
    mechanism=Misreading(_apply, _undo),
    words="In placement {target} the left plate lies {0} further forward and {1} further left than recorded.",
    targets=PLACEMENTS,
    instrument="plates",
)
