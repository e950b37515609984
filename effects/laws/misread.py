"""How a law misreads encoders, cells or the survey of a plate, and how that is undone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tulip_testbed.effects.effect import Values
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import Sentence, sentence_of
from tulip_testbed.effects.laws.quantities import quantity, readings
from tulip_testbed.effects.laws.shapes import basis, fixed_names, range_names, size_names
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.robot import Robot

POSE = ("x", "y", "yaw")
ROUNDS = 20  # of the inversion, where the error depends on the true reading
AT_REST = 1e-10  # rad, N or m


def misread(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
    """Return the measurements that the faulty instruments give."""
    sentence = sentence_of(target)
    observed = observe(m, nominal_robot(robot, common_support(m.support)))
    read: Any = getattr(m, sentence.field) + error(observed, sentence, values)
    return replace(m, **{sentence.field: read})


def undo(observed: Observation, target: str, values: Values) -> Observation:
    """Return the observation with the readings corrected."""
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
    """Compute reading minus truth, in the shape of the readings: joint angles, cells or plate poses.

    Args:
        observed: with true readings.
    """
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
