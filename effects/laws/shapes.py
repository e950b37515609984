"""The shapes of a law: functions of one quantity (of two for the centre of pressure), linear in their sizes.

Within the range [from, to] in which a law was learned; beyond, a function keeps its value at the end.
"""

from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import Sentence

KNOTS = 5  # of a curve
KNOTS_IN_TIME = 8
KNOTS_OF_A_FINE_CURVE = 20
LEAST = 1e-12


def size_names(sentence: Sentence) -> tuple[str, ...]:
    """Name the sizes of a law about one reading."""
    form = sentence.form
    if form in (g.CURVE, g.FINE_CURVE):
        count = KNOTS_IN_TIME if sentence.quantity == g.TIME else KNOTS
        count = KNOTS_OF_A_FINE_CURVE if form == g.FINE_CURVE else count
        return tuple(f"value {k + 1}" for k in range(count))
    if sentence.quantity == g.COP:
        return ("x", "y") if form == g.LINEAR else ("x", "y", "xx", "xy", "yy")
    names = {g.QUADRATIC: ("proportional part", "square part"), g.SINE: ("sine", "cosine")}
    return names.get(form, ("error",))


def fixed_names(sentence: Sentence) -> tuple[str, ...]:
    """Name the numbers of the shape that are chosen, not estimated."""
    return {
        g.SINE: ("periods",),
        g.STEP: () if sentence.quantity == g.DIRECTION else ("place",),
        g.DEAD_BAND: ("width",),
        g.SATURATING: ("constant",),
    }.get(sentence.form, ())


def range_names(sentence: Sentence) -> tuple[str, ...]:
    """Name the ends of the range in which the law was learned."""
    if not g.QUANTITIES[sentence.quantity].ranged:
        return ()
    if sentence.quantity == g.COP:
        return ("from x", "to x", "from y", "to y")
    return ("from", "to")


def basis(sentence: Sentence, x: np.ndarray, fixed: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Compute the functions of a quantity, (m, d), whose sum, each times its size, is the law, (m, s)."""
    low, high = ends[0::2], ends[1::2]
    if len(ends):
        x = np.clip(x, low, high)
    first, form = x[:, 0], sentence.form
    scale = float(max(abs(low[0]), abs(high[0]), LEAST)) if len(ends) else 1.0
    if form == g.CONSTANT:
        return np.ones((len(x), 1))
    if sentence.quantity == g.COP:
        u, v = (x / np.maximum(np.maximum(np.abs(low), np.abs(high)), LEAST)).T
        return np.column_stack([u, v] if form == g.LINEAR else [u, v, u * u, u * v, v * v])
    if form in (g.LINEAR, g.RELAXATION):
        return (first / (1.0 if form == g.RELAXATION else scale))[:, None]
    if form == g.QUADRATIC:
        return np.column_stack([first / scale, (first / scale) ** 2])
    if form == g.SINE:
        turn = fixed[0] * first * (2 * np.pi if sentence.quantity == g.TIME else 1.0)
        return np.column_stack([np.sin(turn), np.cos(turn)])
    if form == g.STEP:
        place = fixed[0] if len(fixed) else 0.0
        return (np.sign(first) if sentence.quantity == g.DIRECTION else (first > place) * 1.0)[:, None]
    if form == g.DEAD_BAND:
        beyond = np.sign(first) * np.maximum(np.abs(first) - fixed[0], 0.0)
        return (beyond / max(scale - fixed[0], LEAST))[:, None]
    if form == g.SATURATING:
        ratio = first / max(fixed[0], LEAST)
        timed = sentence.quantity in (g.TIME, g.LOADED)
        return (-np.expm1(-np.maximum(ratio, 0.0)) if timed else np.tanh(ratio))[:, None]
    part = first if not len(ends) else (first - low[0]) / max(high[0] - low[0], LEAST)
    return _spline(len(size_names(sentence)))(part)


@cache
def _spline(knots: int) -> CubicSpline:
    """Return the natural cubic splines that are 1 at one knot and 0 at the others, over [0, 1]."""
    return CubicSpline(np.linspace(0, 1, knots), np.eye(knots), bc_type="natural")


def choices(sentence: Sentence, x: np.ndarray) -> np.ndarray:
    """List the values of `fixed_names` that a search tries, (g, f), of a measured quantity, (m, d)."""
    form, timed = sentence.form, sentence.quantity == g.TIME
    first = x[:, 0]
    if not fixed_names(sentence):
        return np.zeros((1, 0))
    if form == g.SINE:
        periods = np.arange(1, 4) if timed else np.r_[1:13, 14:26:2, 28:64:4]
        return periods[:, None].astype(float)
    if form == g.STEP:
        return np.unique(np.quantile(first, np.linspace(0.1, 0.9, 17)))[:, None]
    if form == g.DEAD_BAND:
        return (np.abs(first).max() * np.linspace(0.1, 0.8, 8))[:, None]
    largest = float(max(np.abs(first).max(), LEAST))
    return (largest * np.geomspace(0.03, 0.6, 6))[:, None]


def learned_range(sentence: Sentence, x: np.ndarray) -> np.ndarray:
    """Return the range of a quantity that an experiment covers, as `range_names`."""
    if not range_names(sentence):
        return np.zeros(0)
    return np.column_stack([x.min(axis=0), x.max(axis=0)]).ravel()
