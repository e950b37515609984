"""A joint's encoder reads a multiple of the joint's angle: wrong counts per turn, an eccentric disc.

The angle counts from the joint's zero; near it the effect cannot be seen.
"""

from __future__ import annotations

from dataclasses import replace

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import column, misreading
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def read(m: Measurements) -> Measurements:
        factor = 1 + values[0] * column(m.joints, target, len(m.joints))
        return replace(m, joint_angles=m.joint_angles * factor)

    return misreading(rig, read)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    factor = 1 + values[0] * column(observed.tree.joints, target, len(observed.tree.joints))
    return observed.changed(joint_angles=observed.joint_angles / factor)


EFFECT = Effect(
    name="encoder-gain",
    sentence="A joint's encoder reads (1 + gain) times the joint's angle.",
    parameters=(Parameter("gain", "", prior=0.02),),
    inject=_inject,
    predict=_predict,
    words="The {target} encoder reads {0} of its angle too much.",
    targets=JOINTS,
    misreads=True,
)
