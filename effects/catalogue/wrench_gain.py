"""A force-torque sensor reads all forces and moments in proportion too large.

Both sensors alike show in the sum of the forces against the weighed mass. One alone moves the centre of
pressure towards its foot, as much as the load between the feet changes.
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
    assert m.wrenches is not None
    return replace(m, wrenches=m.wrenches * _gain(target, values)[:, None])


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    gain = np.repeat(_gain(target, values), observed.cell_forces.shape[1] // 2)
    below = observed.contacts.below  # it was added, not read
    assert below is not None
    return observed.changed(cell_forces=(observed.cell_forces - below) / gain + below)


def _gain(target: str, values: Values) -> np.ndarray:
    """Return reading over wrench of both sensors, (2,)."""
    gain = np.ones(2)
    gain[PLATES.index(target)] += values[0]
    return gain


EFFECT = Effect(
    name="wrench-gain",
    sentence="A force-torque sensor reads all forces and moments in proportion too large.",
    parameters=(Parameter("gain error", "", prior=0.01),),
    mechanism=Misreading(_apply, _undo),
    words="The {target} force-torque sensor reads {0} too much of any load.",
    targets=PLATE_NAMES,
    instrument="wrenches",
)
