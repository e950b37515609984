"""A joint's encoder has a wrong zero: it was mounted or homed with a constant error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import indicator
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, joint_angles=m.joint_angles + _error(m.joints, target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    error = _error(observed.tree.joints, target, values)
    return observed.changed(joint_angles=observed.joint_angles - error)


def _error(joints: tuple[str, ...], target: str, values: Values) -> np.ndarray:
    """Return reading minus angle, (n_joints,) [rad]."""
    return values[0] * indicator(joints, target)


EFFECT = Effect(
    name="encoder-offset",
    sentence="A joint's encoder reads a constant angle too much.",
    parameters=(Parameter("offset", "rad", prior=np.radians(1.0)),),
    mechanism=Misreading(_apply, _undo),
    words="The {target} encoder reads {0} too high.",
    targets=JOINTS,
)
