"""Recorded poses of plates that are not the true ones: the three effects that write them down wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Values
from tulip_testbed.effects.injection import misreading
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig

# True minus recorded poses, (2, 3) or (m, 2, 3) [m, m, rad], by every posture's placement, target and values.
Shift = Callable[[np.ndarray, str, Values], np.ndarray]


def misrecorded(shift: Shift) -> Callable[[Rig, str, Values], Rig]:
    """An effect's injection: poses are recorded without the shift."""

    def inject(rig: Rig, target: str, values: Values) -> Rig:
        def read(m: Measurements) -> Measurements:
            return replace(m, plate_poses=m.plate_poses - shift(m.placement, target, values))

        return misreading(rig, read)

    return inject


def put_right(shift: Shift) -> Callable[[Observation, str, Values], Observation]:
    """An effect's prediction: the plates are where the shift puts them."""

    def predict(observed: Observation, target: str, values: Values) -> Observation:
        moved = shift(observed.measurements.placement, target, values)
        return observed.changed(plate_poses=observed.plate_poses + moved)

    return predict
