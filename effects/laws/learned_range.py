"""Postures at which a law would have to extrapolate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.errors import shortened
from tulip_testbed.effects.effect import Effect, Values
from tulip_testbed.effects.laws.grammar import LAW, sentence_of
from tulip_testbed.effects.laws.misread import split_values
from tulip_testbed.effects.laws.quantities import quantity, readings
from tulip_testbed.identification.observation import Observation

SLACK = 0.02  # of a range, by which noise may leave it
MOST_NUMBERS = 12


def beyond(observed: Observation, effect: Effect, target: str, values: Values) -> np.ndarray:
    """Return the rows of an observation that lie outside the range in which a law was learned, (k,).

    None do for an effect of the catalogue, or a law that has no range.
    """
    if effect.name != LAW:
        return np.zeros(0, int)
    sentence = sentence_of(target)
    _, _, ends = split_values(sentence, values)
    if not len(ends):
        return np.zeros(0, int)
    low, high = ends[0::2], ends[1::2]
    slack, out = SLACK * (high - low), np.zeros(len(observed), bool)
    for at in readings(observed, sentence):
        x = quantity(observed, sentence, at)
        out |= ((x < low - slack) | (x > high + slack)).any(axis=1)
    return np.flatnonzero(out)


def extrapolation(label: str, observed: Observation, rows: Sequence[int] | np.ndarray) -> str:
    """Warn of postures outside the range in which a law was learned, by number; "" if there are none."""
    if not len(rows):
        return ""
    numbers = np.unique(observed.measurements.posture[rows]).tolist()
    shown = ", ".join(map(str, numbers[:MOST_NUMBERS]))
    more = f" and {len(numbers) - MOST_NUMBERS} more" if len(numbers) > MOST_NUMBERS else ""
    word = "postures" if len(numbers) > 1 else "posture"
    return (
        f"{shortened(label)}: {word} {shown}{more} outside the range in which the law was learned; there "
        "it is held at its value at the range's end: do not trust it there"
    )
