"""A joint's encoder reads a constant angle too much: a wrong zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import column, misreading
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        error = values[0] * column(m.joints, target, len(m.joints))
        return replace(m, joint_angles=m.joint_angles + error)

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    error = values[0] * column(observed.tree.joints, target, len(observed.tree.joints))
    return observed.changed(joint_angles=observed.joint_angles - error)


EFFECT = Effect(
    name="encoder-offset",
    sentence="A joint's encoder reads a constant angle more than the joint has.",
    parameters=(Parameter("offset", "rad", prior=np.radians(1.0)),),
    inject=_inject,
    predict=_predict,
    words="The {target} encoder reads {0} too high.",
    targets=JOINTS,
    misreads=True,
)
