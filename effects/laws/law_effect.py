"""Make the effect that a law says, and tell it in one sentence."""

from __future__ import annotations

import copyreg
from dataclasses import dataclass
from functools import cache

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.laws import force
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import LAW, Sentence, says, sentence_of
from tulip_testbed.effects.laws.law_sentence import told
from tulip_testbed.effects.laws.misread import (
    POSE,
    all_size_names,
    misread,
    split_values,
    undo,
)
from tulip_testbed.effects.laws.shapes import fixed_names, range_names, size_names
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.targets import Targets
from tulip_testbed.sim.robot import Robot

OF_ENCODERS, OF_CELLS, OF_GAINS, OF_PLACES, OF_YAW, OF_FORCES = np.radians(0.5), 1.0, 0.02, 3e-3, 0.01, 2.0
MOST_PERIODS = 200.0  # a turn, or in the experiment: finer ones no posture plan resolves


@dataclass(frozen=True, repr=False)
class Law(Effect):
    """An effect that the grammar makes.

    Attributes:
        target: the only one that it has.
    """

    target: str = ""

    def refusal(self, values: Values) -> str:
        """Say why the range in which the law was learned is none, "" if it is one."""
        sentence = sentence_of(self.target)
        _, fixed, ends = split_values(sentence, values)
        low, high = ends[0::2], ends[1::2]
        if not (low < high).all():
            return "found a range that does not grow, expected FROM < TO"
        for name, value in zip(fixed_names(sentence), fixed.tolist(), strict=True):
            if sentence.form == g.SINE and not 0 < value <= MOST_PERIODS:
                return f"found {value:g} {name}, expected a number above 0, {MOST_PERIODS:g} at most"
            if sentence.form in (g.SATURATING, g.DEAD_BAND) and not value > 0:
                return f"found {name} {value:g}, expected a number above 0"
            if sentence.form == g.STEP and sentence.quantity == g.TIME and not 0 <= value <= 1:
                return f"found {name} {value:g}, expected a part of the experiment's time, 0 to 1"
        return ""

    def told(self, target: str, values: Values, intervals: tuple[tuple[float, float] | None, ...]) -> str:
        """Tell the law with its sizes in one sentence, and what is a guess in it."""
        return told(sentence_of(target), self.parameters, values, intervals)


def law_effect(target: str, where: str = LAW) -> Effect:
    """Return the effect that a law of this target says.

    Raises:
        InputError: a sentence that makes no sense, with those that do.
    """
    sentence_of(target, where)
    return _law_effect(target)


@cache
def _law_effect(target: str) -> Effect:
    sentence = sentence_of(target)

    def of(robot: Robot, placements: tuple[int, ...]) -> tuple[str, ...]:
        return (target,) if says(robot, sentence) else ()

    misreads = sentence.kind != g.FORCE
    return Law(
        name=LAW,
        sentence=f"A law composed of what errs, as a function of what, in which shape: {target}.",
        parameters=_parameters(sentence),
        mechanism=Misreading(misread, undo) if misreads else Physics(force.inject, force.remove),
        words="",
        targets=Targets("WHAT/OF/SHAPE", of),
        instrument=g.KINDS[sentence.kind].instrument,
        target=target,
    )


copyreg.pickle(Law, lambda law: (law_effect, (law.target,)))


def _parameters(sentence: Sentence) -> tuple[Parameter, ...]:
    if sentence.kind == g.FORCE:
        sizes = tuple(Parameter(axis, "N", prior=OF_FORCES) for axis in force.AXES)
    elif sentence.kind == g.PLATE:
        each = len(size_names(sentence))
        units = [("rad", OF_YAW) if axis == "yaw" else ("m", OF_PLACES) for axis in POSE for _ in range(each)]
        sizes = tuple(
            Parameter(name, unit, prior=prior)
            for name, (unit, prior) in zip(all_size_names(sentence), units, strict=True)
        )
    else:
        unit, prior = _of_reading(sentence)
        sizes = tuple(Parameter(name, unit, prior=prior) for name in size_names(sentence))
    unit = g.QUANTITIES[sentence.quantity].unit
    fixed = tuple(
        Parameter(name, "" if name == "periods" else unit, fixed=True) for name in fixed_names(sentence)
    )
    return sizes + fixed + tuple(Parameter(name, unit, fixed=True) for name in range_names(sentence))


def _of_reading(sentence: Sentence) -> tuple[str, float]:
    """Return the unit and the plausible size of the error of a reading."""
    if sentence.field == "joint_angles":
        return ("", 0.05) if sentence.form == g.RELAXATION else ("rad", OF_ENCODERS)
    if sentence.scales or sentence.form == g.RELAXATION:
        return "", OF_GAINS
    return "N", OF_CELLS
