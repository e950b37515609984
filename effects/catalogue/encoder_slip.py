"""A joint's encoder slips on its shaft during the experiment and reads an angle too much from then on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import STARTS, indicator
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation, fraction_of_time
from tulip_testbed.measurements import Measurements


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    error = _error(m.joints, target, fraction_of_time(m.time), values)
    return replace(m, joint_angles=m.joint_angles + error)


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    error = _error(observed.tree.joints, target, observed.time_fraction, values)
    return observed.changed(joint_angles=observed.joint_angles - error)


def _error(joints: tuple[str, ...], target: str, time: np.ndarray, values: Values) -> np.ndarray:
    """Return reading minus angle, (m, n_joints) [rad].

    Args:
        time: of the postures, as a fraction of the experiment's, (m,).
    """
    slip, start = values
    return slip * np.outer(time >= start, indicator(joints, target))


EFFECT = Effect(
    name="encoder-slip",
    sentence="A joint's encoder slips: from some time on it reads an angle too much.",
    parameters=(
        Parameter("slip", "rad", prior=np.radians(1.0)),
        Parameter("start", "", grid=STARTS),
    ),
    mechanism=Misreading(_apply, _undo),
    words="The {target} encoder slipped and reads {0} too high from {1} of the experiment's time on.",
    targets=JOINTS,
)
