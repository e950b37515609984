"""The quantities on which an error may depend, as an observation shows them."""

from __future__ import annotations

import numpy as np

from tulip_testbed.effects.injection import successive
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import Sentence, joints_that_err
from tulip_testbed.effects.targets import plate_of
from tulip_testbed.identification.observation import Observation, turned
from tulip_testbed.measurements.cells import CELLS, PLATES


def readings(observed: Observation, sentence: Sentence) -> list[int]:
    """Return the columns of the joint angles, or of the cells, that err; a plate has one."""
    if sentence.field == "joint_angles":
        names = observed.tree.joints
        return [names.index(one) for one in joints_that_err(observed.nominal.robot, sentence.what)]
    if sentence.kind == g.CELL:
        return [CELLS.index(sentence.place)]
    if sentence.kind == g.CELLS_OF:
        return [k for k, cell in enumerate(CELLS) if cell.startswith(sentence.place)]
    return [0]


def quantity(observed: Observation, sentence: Sentence, reading: int) -> np.ndarray:
    """Return the quantity on which the error of a reading depends, (m, d) [rad, Nm, N, m, s or a fraction].

    Times are in seconds since the set-up began, or as a fraction of the experiment; the centre of pressure
    has d = 2 and the plate's axes, everything else d = 1.
    """
    m, name = len(observed), sentence.quantity
    if name == g.NOTHING:
        return np.zeros((m, 1))
    if name in (g.OWN_ANGLE, g.ANGLE, g.OWN_TORQUE, g.TORQUE):
        at = observed.tree.joints.index(sentence.joint) if sentence.joint else reading
        return (observed.joint_angles if name in (g.OWN_ANGLE, g.ANGLE) else observed.torques)[:, [at]]
    if name == g.TIME:
        return observed.time_fraction[:, None]
    if name == g.LOADED:
        return since_loading(observed)[:, None]
    if name in (g.BEFORE, g.DIRECTION):
        own, change = getattr(observed, sentence.field), np.zeros((m, 1))
        for previous, row in successive(observed.measurements):
            change[row] = own[previous, reading] - own[row, reading]
        return change if name == g.BEFORE else -np.sign(change)
    side = _side(observed, sentence, reading)
    if name == g.COP:
        pose = observed.plate_poses[:, side]
        return turned(-pose[:, 2], observed.foot_loads[1][:, side] - pose[:, :2])
    return observed.foot_loads[0][:, [side]]


def since_loading(observed: Observation) -> np.ndarray:
    """Return the time since the first posture of each set-up, (m,) [s]."""
    time, stance = observed.measurements.time, observed.measurements.placement
    begun = {number: time[stance == number].min() for number in np.unique(stance).tolist()}
    return time - np.array([begun[number] for number in stance.tolist()])


def _side(observed: Observation, sentence: Sentence, reading: int) -> int:
    if sentence.field == "joint_angles":
        return PLATES.index(plate_of(observed.nominal.robot, observed.tree.joints[reading]))
    return PLATES.index(sentence.place.partition(".")[0])
