"""Effects in words: values in the units that a laboratory speaks."""

from __future__ import annotations

import math

from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.instance import EffectInstance

SPOKEN = {
    "": (100.0, "%"),
    "rad": (180 / math.pi, "deg"),
    "rad/Nm": (180 / math.pi, "deg/Nm"),
    "m": (1e3, "mm"),
}


def spoken(parameter: Parameter, value: float, interval: tuple[float, float] | None = None) -> str:
    """A value as text, with the longer half of its 95 % interval where there is one.

    Args:
        value, interval: in the parameter's unit.
    """
    if parameter.choices:
        return parameter.choices[round(value)].replace("_", " ")
    factor, unit = SPOKEN.get(parameter.unit, (1.0, parameter.unit))
    if interval is None:
        return f"{factor * value:.3g} {unit}".strip()
    # An interval that ends at zero is cut there.
    half = factor * max(interval[1] - value, value - interval[0])
    digits = max(0, 1 - math.floor(math.log10(half))) if half > 0 else 3
    return f"{factor * value:.{digits}f} +- {half:.{digits}f} {unit}".strip()


def told(found: EffectInstance) -> str:
    """The finding as a sentence."""
    intervals = found.intervals or (None,) * len(found.values)
    texts = [
        spoken(parameter, value, interval)
        for parameter, value, interval in zip(found.effect.parameters, found.values, intervals, strict=True)
    ]
    return found.effect.words.format(*texts, target=found.target.replace("_", " ").replace(".", " "))
