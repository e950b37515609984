"""Tell a law in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.effects.effect import Parameter, Values
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import Sentence
from tulip_testbed.effects.laws.shapes import fixed_names, range_names

GUESS = "The curve is measured; its cause is a guess."
Intervals = Sequence[tuple[float, float] | None]
FINE = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "": (100.0, "%")}  # units of small errors
TURN = 180 / np.pi


def told(sentence: Sentence, parameters: tuple[Parameter, ...], values: Values, intervals: Intervals) -> str:
    """Tell a law with its sizes.

    Args:
        intervals: of the values; empty: none.
    """
    how = _how(sentence, parameters, values, intervals)
    return f"{what_errs(sentence)} {as_what(sentence)}{how}. {GUESS}"


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
