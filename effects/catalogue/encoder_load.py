"""A joint's encoder errs in proportion to the load on its leg, which shifts the shaft against the read
head.

reading = angle + rate times the vertical force on the foot below the joint. Any joint of a leg can have it,
also one whose own torque is small. The size is assumed: a shift by 0.1 mm on a ring of 30 mm radius reads
0.2 degrees, here under the full weight of a robot of 23 kg.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.injection import indicator
from tulip_testbed.effects.targets import LEG_JOINTS, plate_of
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CORNERS, PLATES


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    return replace(m, joint_angles=m.joint_angles + _error(m.joints, _down(m), target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    error = _error(observed.tree.joints, observed.foot_loads[0], target, values)
    return observed.changed(joint_angles=observed.joint_angles - error)


def _down(m: Measurements) -> np.ndarray:
    """Return the vertical force on both feet as it is read, (m, 2) [N]."""
    if m.contacts is None or m.wrenches is None:
        return m.cell_forces.reshape(-1, len(PLATES), len(CORNERS)).sum(axis=2)
    return m.wrenches[:, :, m.contacts.channels.index("fz")]


def _error(joints: tuple[str, ...], down: np.ndarray, target: str, values: Values) -> np.ndarray:
    """Return reading minus angle, (m, n_joints) [rad].

    Args:
        down: vertical force on both feet, (m, 2) [N].
        target: the plate under the joint's leg and the joint, `PLATE.JOINT`.
    """
    plate, _, joint = target.partition(".")
    return values[0] * np.outer(down[:, PLATES.index(plate)], indicator(joints, joint))


EFFECT = Effect(
    name="encoder-load",
    sentence="A joint's encoder reads too much in proportion to the vertical force on the foot of its leg.",
    parameters=(Parameter("rate", "rad/N", prior=np.radians(0.001)),),
    mechanism=Misreading(_apply, _undo, acts_on=lambda robot, joint: f"{plate_of(robot, joint)}.{joint}"),
    words="The {target} encoder reads {0} too high under the load of its leg.",
    targets=LEG_JOINTS,
)
