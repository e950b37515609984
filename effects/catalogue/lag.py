"""A joint's reading lags: it keeps a part of the posture before, as behind a sluggish filter.

reading = angle + part (previous angle - angle). The previous angle is that of the preceding row in the
order of time, even if a posture was tried in between and dropped. Where the robot was set down again
(another placement or support) it was carried for minutes in between, so the reading begins afresh, without
lag.
"""

from __future__ import annotations

from dataclasses import replace

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import successive
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    joint, read = m.joints.index(target), m.joint_angles.copy()
    for previous, row in successive(m):
        read[row, joint] += values[0] * (m.joint_angles[previous, joint] - m.joint_angles[row, joint])
    return replace(m, joint_angles=read)


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    joint, angles, part = observed.tree.joints.index(target), observed.joint_angles.copy(), values[0]
    for previous, row in successive(observed.measurements):
        angles[row, joint] = (angles[row, joint] - part * angles[previous, joint]) / (1 - part)
    return observed.changed(joint_angles=angles)


EFFECT = Effect(
    name="lag",
    sentence="A joint's reading lags behind by a fraction of the last change of its angle.",
    parameters=(Parameter("part", "", prior=0.005),),
    mechanism=Misreading(_apply, _undo),
    words="The reading of the {target} joint lags behind by {0} of the last change of its angle.",
    targets=JOINTS,
)
