"""One load cell's zero drifts, evenly over the experiment: it was tared at its beginning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import column, misreading
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.identification.observation import Observation, time_fraction
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import CELLS


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(m, cell_forces=m.cell_forces + _drift(time_fraction(m.time), target, values))

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cell_forces=observed.cell_forces - _drift(observed.part, target, values))


def _drift(part: np.ndarray, target: str, values: Values) -> np.ndarray:
    """What is read too much, (m, 8) [N]."""
    return values[0] * np.outer(part, column(CELLS, target, len(CELLS)))


EFFECT = Effect(
    name="cell-drift",
    sentence="A load cell's zero drifts evenly, from nothing at the first posture to this at the last.",
    parameters=(Parameter("drift", "N", prior=2.0),),
    inject=_inject,
    predict=_predict,
    words="The {target} cell drifts by {0} over the experiment.",
    targets=CELL_NAMES,
    misreads=True,
)
