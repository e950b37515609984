"""How a law misreads encoders, cells or a plate's survey, by the quantities that an observation shows."""

from dataclasses import replace
from typing import Any

import numpy as np

from tulip_testbed.effects.effect import Values
from tulip_testbed.effects.injection import successive
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import Sentence, joints_that_err, sentence_of
from tulip_testbed.effects.laws.shapes import basis, fixed_names, range_names, size_names
from tulip_testbed.effects.targets import plate_of
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe, turned
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.robot import Robot


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


def misread_by(observed: Observation, sentence: Sentence) -> list[str]:
    """Name the joints or the cells whose readings err by a law; a plate's place or a force has none."""
    names = {"joint_angles": observed.tree.joints, "cell_forces": CELLS}.get(sentence.field, ())
    return [names[k] for k in readings(observed, sentence)] if names else []


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
    rates = observed.measurements.joint_rates
    if name == g.DIRECTION and sentence.field == "joint_angles" and rates is not None:
        return np.sign(rates[:, [reading]])
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


POSE = ("x", "y", "yaw")
ROUNDS = 20  # of the inversion, where the error depends on the true reading
AT_REST = 1e-10  # rad, N or m


def misread(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
    sentence = sentence_of(target)
    observed = observe(m, nominal_robot(robot, common_support(m.support)))
    read: Any = getattr(m, sentence.field) + error(observed, sentence, values)
    return replace(m, **{sentence.field: read})


def undo(observed: Observation, target: str, values: Values) -> Observation:
    sentence = sentence_of(target)
    name = sentence.field
    read, true = getattr(observed, name), observed
    before: np.ndarray | None = None
    for _ in range(ROUNDS):
        wrong = error(true, sentence, values)
        if before is not None and np.abs(wrong - before).max(initial=0.0) < AT_REST:
            break
        true, before = observed.changed(**{name: read - wrong}), wrong
        if not _of_itself(sentence):
            break
    return true


def error(observed: Observation, sentence: Sentence, values: Values) -> np.ndarray:
    """Compute reading minus truth, in the shape of angles, cells or plate poses, from true readings."""
    sizes, fixed, ends = split_values(sentence, values)
    out = np.zeros_like(getattr(observed, sentence.field))
    for at in readings(observed, sentence):
        functions = basis(sentence, quantity(observed, sentence, at), fixed, ends)
        if sentence.kind == g.PLATE:
            out[:, PLATES.index(sentence.place)] = functions @ sizes.reshape(len(POSE), -1).T
        elif sentence.scales:
            out[:, at] = functions @ sizes * observed.cell_forces[:, at]
        else:
            out[:, at] = functions @ sizes
    return out


def split_values(sentence: Sentence, values: Values) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split the values of a law into sizes, fixed numbers of the shape, and ends of the range."""
    fixed, ends = len(fixed_names(sentence)), len(range_names(sentence))
    count = len(values) - fixed - ends
    each = np.array(values, float)
    return each[:count], each[count : count + fixed], each[count + fixed :]


def all_size_names(sentence: Sentence) -> tuple[str, ...]:
    """Name all sizes of a law; that of a plate has those of its shape for x, y and yaw each."""
    names = size_names(sentence)
    if sentence.kind != g.PLATE:
        return names
    return tuple(f"{axis}, {name}" if len(names) > 1 else axis for axis in POSE for name in names)


def _of_itself(sentence: Sentence) -> bool:
    """Whether the error depends on the readings that err, so that it takes several rounds to undo."""
    if sentence.field == "joint_angles":
        return sentence.quantity in (g.OWN_ANGLE, g.OWN_TORQUE, g.TORQUE, g.BEFORE, g.DIRECTION)
    return sentence.kind != g.PLATE and (
        sentence.scales or sentence.quantity in (g.PLATE_LOAD, g.COP, g.BEFORE, g.DIRECTION)
    )
