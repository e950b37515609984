"""A discovery's residuals as curves over the experiment, with the noise that they should have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import ANCHORED, residuals_in_use
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
    observed = observe(
        discovery.measurements, nominal_robot(discovery.robot, common_support(discovery.measurements.support))
    )
    sd = _spread(discovery, observed)
    before, after = (about_stances(discovery.residual(side), observed.stance) for side in ("before", "after"))
    order = time_order(discovery)
    return [
        Curve(channel, name, unit, *(scale * side[order, j] for side in (before, after, sd)))
        for j, (name, unit, scale, channel) in enumerate(SHOWN)
    ]


def time_order(discovery: Discovered) -> np.ndarray:
    """Return the rows of the measurements in the order of time, (m,)."""
    return np.argsort(discovery.measurements.time, kind="stable")


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
