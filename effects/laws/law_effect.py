"""Make the effect that a law says, and tell it in one sentence.

A law's force on a link is constant, from a time on, or grows with time. The simulation ties the link's centre
of mass by a soft spring to a point a kilometre away. Its removal moves the centre of pressure by the force's
moment about the floor of the cells; what pulls down is added to the weight.
"""

import copyreg
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited, from_then_on
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import LAW, Sentence, says, sentence_of
from tulip_testbed.effects.laws.misread import POSE, all_size_names, misread, split_values, undo
from tulip_testbed.effects.laws.shapes import fixed_names, range_names, size_names
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.ropes import FAR, hook, tie, without_force
from tulip_testbed.effects.targets import Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot

AXES = ("x", "y", "z")
STAGES = 20  # in which a force grows: half of one is 2.5 % of it
OF_ENCODERS, OF_CELLS, OF_GAINS, OF_PLACES, OF_YAW, OF_FORCES = np.radians(0.5), 1.0, 0.02, 3e-3, 0.01, 2.0
MOST_PERIODS = 200.0  # a turn, or in the experiment: finer ones no posture plan resolves
GUESS = "The curve is measured; its cause is a guess."
Intervals = Sequence[tuple[float, float] | None]
FINE = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "": (100.0, "%")}  # units of small errors
TURN = 180 / np.pi


def _pull(rig: Rig, target: str, values: Values) -> Rig:
    sentence, force = sentence_of(target), np.array(values[:3])
    size = float(np.linalg.norm(force))
    if size == 0:
        return rig
    hooked, reach = hook(rig.robot, sentence.place), FAR * force / size

    def pulling(count: int, part: float) -> Callable[[Rig], Rig]:
        name = f"force_{sentence.place}_{sentence.quantity}_{count}"
        return lambda one: edited(one, lambda spec: tie(spec, name, hooked, reach, part * size / FAR, 0.0))

    if sentence.quantity == g.NOTHING:
        return pulling(0, 1.0)(rig)
    if sentence.form == g.STEP:
        return from_then_on(rig, values[3], pulling(0, 1.0))
    for count in range(STAGES):
        rig = from_then_on(rig, (count + 0.5) / STAGES, pulling(count, 1 / STAGES))
    return rig


def _without_pull(observed: Observation, target: str, values: Values) -> Observation:
    sentence = sentence_of(target)
    time = observed.time_fraction
    part = {g.CONSTANT: np.ones(len(time)), g.LINEAR: time}.get(sentence.form)
    force = np.outer(time >= values[3] if part is None else part, values[:3])
    return without_force(observed, sentence.place, force)


@dataclass(frozen=True, repr=False)
class Law(Effect):
    """An effect that the grammar makes, with its only target."""

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
        sentence = sentence_of(target)
        how = _how(sentence, self.parameters, values, intervals)
        return f"{what_errs(sentence)} {as_what(sentence)}{how}. {GUESS}"


def law_effect(target: str, where: str = LAW) -> Effect:
    """Return the effect that a law of this target says; refuse a sentence that makes no sense."""
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
        mechanism=Misreading(misread, undo) if misreads else Physics(_pull, _without_pull),
        words="",
        targets=Targets("WHAT/OF/SHAPE", of),
        instrument=g.KINDS[sentence.kind].instrument,
        target=target,
    )


copyreg.pickle(Law, lambda law: (law_effect, (law.target,)))


def _parameters(sentence: Sentence) -> tuple[Parameter, ...]:
    if sentence.kind == g.FORCE:
        sizes = tuple(Parameter(axis, "N", prior=OF_FORCES) for axis in AXES)
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


def what_errs(sentence: Sentence) -> str:
    """Return the subject and the verb of the sentence."""
    return g.KINDS[sentence.kind].words.format(sentence.place.replace("_", " ").replace(".", " "))


def as_what(sentence: Sentence) -> str:
    """Return on what the error depends."""
    own = "their" if sentence.kind in (g.ENCODERS, g.CELLS_OF) else "its"
    words = g.QUANTITIES[sentence.quantity].words.format(own=own, joint=sentence.joint.replace("_", " "))
    return f"{words}, in proportion to the load on it," if sentence.scales else words


def _how(sentence: Sentence, parameters: tuple[Parameter, ...], values: Values, intervals: Intervals) -> str:
    count = len(values) - len(fixed_names(sentence)) - len(range_names(sentence))
    known = list(intervals) or [None] * len(values)
    sizes = [_size(p, v, i) for p, v, i in zip(parameters[:count], values, known[:count], strict=False)]
    fixed = [_shown(p, v) for p, v in zip(parameters[count:], values[count:], strict=True)]
    if sentence.kind in (g.PLATE, g.FORCE) or sentence.quantity == g.COP or sentence.form == g.QUADRATIC:
        at = f" from {fixed[0]} on" if sentence.form == g.STEP else ""
        if sentence.kind == g.FORCE and sentence.form == g.LINEAR:
            at = " and grows in proportion, at the end to"
        each = ", ".join(f"{p.name} {text}" for p, text in zip(parameters, sizes, strict=False))
        return f"{at} ({each})"
    if sentence.form == g.SINE:
        pair, half = np.hypot(values[0], values[1]), _half(values, known)
        turns = "the experiment" if sentence.quantity == g.TIME else "a turn"
        periods = "one period" if values[count] == 1 else f"{number(values[count])} periods"
        return f" like a sine of {periods} {turns}, {_plus_minus(parameters[0].unit, float(pair), half)}"
    if sentence.form in (g.CURVE, g.FINE_CURVE):
        largest = int(np.abs(values[:count]).argmax())
        ends = f" from {fixed[-2]} to {fixed[-1]}" if range_names(sentence) else ""
        return f" along a smooth curve{ends}, at most {sizes[largest]}"
    words = {
        g.CONSTANT: f" by {sizes[0]}",
        g.LINEAR: f" in proportion, {sizes[0]} at the far end",
        g.STEP: f" by {sizes[0]}" + (f" beyond {fixed[0]}" if fixed_names(sentence) else ""),
        g.DEAD_BAND: f" beyond ± {fixed[0] if fixed else ''}, {sizes[0]} at the far end",
        g.SATURATING: f" and saturates (constant {fixed[0] if fixed else ''}), by {sizes[0]}",
        g.RELAXATION: f" by {sizes[0]} of the last change",
    }
    return words[sentence.form]


def _half(values: Values, intervals: Intervals) -> float | None:
    """Return half of the 95 % interval of the amplitude of a sine, to first order."""
    first, second = intervals[:2]
    if first is None or second is None:
        return None
    widths = np.array([first[1] - first[0], second[1] - second[0]]) / 2
    pair = np.array(values[:2])
    return float(np.linalg.norm(widths * pair) / max(np.linalg.norm(pair), 1e-300))


def _size(parameter: Parameter, value: float, interval: tuple[float, float] | None) -> str:
    half = None if interval is None else max(interval[1] - value, value - interval[0])
    return _plus_minus(parameter.unit, value, half)


def _plus_minus(unit: str, value: float, half: float | None) -> str:
    factor, shown = FINE.get(unit, (1.0, unit))
    if half is None or half <= 0:
        return f"{number(factor * value, '.2g')} {shown}"
    digits = max(0, 1 - int(np.floor(np.log10(factor * half))))
    return f"{number(factor * value, f'.{digits}f')} ± {number(factor * half, f'.{digits}f')} {shown}"


def _shown(parameter: Parameter, value: float) -> str:
    if parameter.unit == "rad":
        return f"{number(TURN * value, '.3g')} deg"
    if parameter.unit == "of the time":
        return f"{number(100 * value, '.3g')} % of the time"
    return f"{number(value, '.3g')} {parameter.unit}".strip()
