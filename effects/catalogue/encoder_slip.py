"""A joint's encoder slips on its shaft during the experiment: from then on it reads an angle too much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import STARTS, column, misreading
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation, time_fraction
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        return replace(
            m, joint_angles=m.joint_angles + _error(m.joints, target, time_fraction(m.time), values)
        )

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    error = _error(observed.tree.joints, target, observed.part, values)
    return observed.changed(joint_angles=observed.joint_angles - error)


def _error(joints: tuple[str, ...], target: str, part: np.ndarray, values: Values) -> np.ndarray:
    """What is read too much, (m, n_joints) [rad]."""
    slip, start = values
    return slip * np.outer(part >= start, column(joints, target, len(joints)))


EFFECT = Effect(
    name="encoder-slip",
    sentence="A joint's encoder slips: from a part of the experiment's time on it reads an angle too much.",
    parameters=(
        Parameter("slip", "rad", prior=np.radians(1.0)),
        Parameter("start", "", grid=STARTS),
    ),
    inject=_inject,
    predict=_predict,
    words="The {target} encoder slipped and reads {0} too high, from {1} of the experiment on.",
    targets=JOINTS,
    misreads=True,
)
