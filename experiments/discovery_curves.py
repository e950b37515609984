"""Curves of a discovery: residuals over the experiment, and its laws with the residuals on them."""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws import sentence_of
from tulip_testbed.effects.laws.law_effect import FINE, TURN, as_what, what_errs
from tulip_testbed.effects.laws.misread import quantity, readings, split_values
from tulip_testbed.effects.laws.shapes import basis
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import ANCHORED, fields, has_direction, residuals_in_use
from tulip_testbed.identification.residual_noise import whitening

# What each part is called, its unit, how many of it go on one SI unit, its channel.
SHOWN = (
    ("centre of pressure, x", "mm", 1e3, "A"),
    ("centre of pressure, y", "mm", 1e3, "A"),
    ("sum of the vertical forces", "N", 1.0, "F"),
    ("twist, right plate", "N", 1.0, "T"),
    ("twist, left plate", "N", 1.0, "T"),
    ("swing foot's height", "mm", 1e3, "C"),
    ("swing foot's roll", "mrad", 1e3, "C"),
    ("swing foot's pitch", "mrad", 1e3, "C"),
    ("swing foot's x", "mm", 1e3, "C"),
    ("swing foot's y", "mm", 1e3, "C"),
    ("swing foot's yaw", "mrad", 1e3, "C"),
)
ALONG = {  # what six-axis sensors in the feet have in place of the twist
    "twist, right plate": ("force's direction along x", "mrad", 1e3, "T"),
    "twist, left plate": ("force's direction along y", "mrad", 1e3, "T"),
}
POINTS = 200
DRAWN = (g.ENCODER, g.ENCODERS, g.CELL, g.CELLS_OF)  # what errs by one number a reading
LEAST_INFORMATION = 1e-12


@dataclass(frozen=True)
class Curve:
    """One residual over the experiment, in the unit that it is shown in.

    Attributes:
        channel: "A", "F", "T" or "C". before, after, sd: (m,); nan where the posture does not have it.
    """

    channel: str
    name: str
    unit: str
    before: np.ndarray
    after: np.ndarray
    sd: np.ndarray


def residual_curves(discovery: Discovered) -> list[Curve]:
    """Compute all residuals in the order of time, with the standard deviations that the noise gives them.

    The swing foot's x, y and yaw are known up to a constant of the stance, hence given about its mean.
    """
    observed = _observed(discovery)
    sd = _spread(discovery, observed)
    before, after = (about_stances(discovery.residual(side), observed.stance) for side in ("before", "after"))
    order = time_order(discovery)
    shown = [ALONG.get(one[0], one) for one in SHOWN] if has_direction(observed) else SHOWN
    return [
        Curve(channel, name, unit, *(scale * side[order, j] for side in (before, after, sd)))
        for j, (name, unit, scale, channel) in enumerate(shown)
    ]


def _observed(discovery: Discovered) -> Observation:
    measured = discovery.searched
    return observe(measured, nominal_robot(discovery.robot, common_support(measured.support)))


def time_order(discovery: Discovered) -> np.ndarray:
    """Return the rows of the measurements in the order of time, (m,)."""
    return np.argsort(discovery.searched.time, kind="stable")


def _spread(discovery: Discovered, observed: Observation) -> np.ndarray:
    """Compute the standard deviation of every residual by the noise that the discovery assumed, (m, 11)."""
    noise = discovery.noise
    white = whitening(observed, observed.nominal.value, noise)
    n = len(observed.tree.joints)
    levers = white.sensitivity[..., n + 8 : n + 14] * noise.plates
    variance = np.diagonal(white.own, axis1=1, axis2=2) + (levers**2).sum(axis=2)
    return np.sqrt(np.where(residuals_in_use(observed), variance, np.nan))


def about_stances(residual: np.ndarray, stance: np.ndarray) -> np.ndarray:
    """Return residuals in which the swing foot's x, y and yaw are about their mean in each stance."""
    out = residual.copy()
    for number in np.unique(stance):
        rows = np.flatnonzero(stance == number)
        out[rows, ANCHORED] -= out[rows, ANCHORED].mean(axis=0)
    return out


@dataclass(frozen=True)
class LawCurve:
    """A law as a curve, in the units in which it is shown.

    Attributes:
        title: what errs and with what. x_unit, unit: of the quantity and of the error.
        x, curve: of the law, (n,).
        at, error, sd: quantity, error of the reading as the residuals show it, and its s.d., one per posture
            and reading, (k,).
    """

    title: str
    x_unit: str
    unit: str
    x: np.ndarray
    curve: np.ndarray
    at: np.ndarray
    error: np.ndarray
    sd: np.ndarray


def law_curves(discovery: Discovered) -> list[LawCurve]:
    """Compute the curves of the adopted laws of one quantity.

    The error of a reading is the law's, and what is left of the posture's residuals along the reading's
    sensitivity, weighed by the noise of the other readings alone.
    """
    return [curve for law, _ in discovery.laws if (curve := _curve(discovery, law)) is not None]


def _curve(discovery: Discovered, law: EffectInstance) -> LawCurve | None:
    sentence = sentence_of(law.target)
    if sentence.kind not in DRAWN or sentence.quantity in (g.NOTHING, g.COP):
        return None
    observed = _observed(discovery)
    sizes, fixed, ends = split_values(sentence, law.values)
    white = whitening(observed, observed.nominal.value, discovery.noise)
    used = residuals_in_use(observed)
    left = np.where(used, about_stances(discovery.residual("after"), observed.stance), 0.0)
    weight = np.where(used, 1 / np.maximum(np.diagonal(white.own, axis1=1, axis2=2), 1e-300), 0.0)
    first = fields(observed)["angles" if sentence.kind in (g.ENCODER, g.ENCODERS) else "cells"].start
    at, error, sd = [], [], []
    for reading in readings(observed, sentence):
        x = quantity(observed, sentence, reading)
        slope = white.sensitivity[:, :, first + reading]
        scale = observed.cell_forces[:, reading] if sentence.scales else np.ones(len(observed))
        information = (weight * slope**2).sum(axis=1) * scale**2
        there = information > LEAST_INFORMATION * max(float(information.max()), 1e-300)
        rest = (weight * slope * left).sum(axis=1) * scale / np.where(there, information, np.inf)
        law_there = basis(sentence, x, fixed, ends) @ sizes
        at.append(x[there, 0])
        error.append((law_there + rest)[there])
        sd.append(1 / np.sqrt(information[there]))
    every = np.concatenate(at)
    low, high = (ends[0], ends[1]) if len(ends) else (every.min(), every.max())
    x = np.linspace(low, high, POINTS)
    unit = "" if sentence.scales else law.effect.parameters[0].unit
    factor, shown = FINE.get(unit, (1.0, unit))
    quantity_unit = g.QUANTITIES[sentence.quantity].unit
    turn, x_unit = (TURN, "deg") if quantity_unit == "rad" else (1.0, quantity_unit)
    return LawCurve(
        title=f"{what_errs(sentence)} {as_what(sentence)}",
        x_unit=x_unit,
        unit=shown,
        x=turn * x,
        curve=factor * (basis(sentence, x[:, None], fixed, ends) @ sizes),
        at=turn * every,
        error=factor * np.concatenate(error),
        sd=factor * np.concatenate(sd),
    )
