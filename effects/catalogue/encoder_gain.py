"""A joint's encoder reads a multiple of the joint's angle: the counts per turn or the disc are wrong.

The angle is measured from the joint's zero, so postures near zero cannot show the effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import indicator
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, joint_angles=m.joint_angles * _factor(m.joints, target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    factor = _factor(observed.tree.joints, target, values)
    return observed.changed(joint_angles=observed.joint_angles / factor)


def _factor(joints: tuple[str, ...], target: str, values: Values) -> np.ndarray:
    """Return reading over angle, (n_joints,)."""
    return 1 + values[0] * indicator(joints, target)


EFFECT = Effect(
    name="encoder-gain",
    sentence="A joint's encoder reads (1 + gain) times the joint's angle.",
    parameters=(Parameter("gain", "", prior=0.02),),
    mechanism=Misreading(_apply, _undo),
    words="The {target} encoder reads {0} of its angle too much.",
    targets=JOINTS,
)
