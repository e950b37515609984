"""What might be missing: every effect of the catalogue on every target, and its columns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from tulip_testbed.discovery.linear_model import Linear
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.effect import Effect, Values
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import packed, residuals

STEP = 1e-2  # of the prior s.d., at which an effect's column is taken


@dataclass(frozen=True)
class Candidate:
    """An effect on a target, with what its sizes may be.

    Attributes:
        settings: values of all parameters with sizes zero, one for every point of the grid, (g, k).
    """

    effect: Effect
    target: str
    settings: np.ndarray

    @property
    def label(self) -> str:
        """As on the command line."""
        return f"{self.effect.name}:{self.target}" if self.target else self.effect.name

    @property
    def prior(self) -> np.ndarray:
        """Prior s.d. of the sizes, (s,)."""
        return np.array([self.effect.parameters[k].prior for k in self.effect.sizes])

    @property
    def positive(self) -> np.ndarray:
        """Which sizes cannot be negative, (s,) bool."""
        return np.array([self.effect.parameters[k].positive for k in self.effect.sizes], bool)

    def values(self, sizes: np.ndarray, point: int = 0) -> Values:
        """All parameters, from the sizes and the number of a grid point."""
        values = self.settings[point].copy()
        values[list(self.effect.sizes)] = sizes
        return tuple(float(value) for value in values)


def candidates(observed: Observation, effects: dict[str, Effect] | None = None) -> list[Candidate]:
    """All of the catalogue that may concern an experiment.

    Args:
        effects: by name; the catalogue if None.
    """
    numbers = tuple(int(number) for number in np.unique(observed.measurements.placement))
    out = []
    for effect in (catalogue() if effects is None else effects).values():
        grids = [parameter.grid or (0.0,) for parameter in effect.parameters]
        settings = np.array(list(product(*grids)), float).reshape(-1, len(grids))
        out += [
            Candidate(effect, target, settings)
            for target in effect.targets.of(observed.nominal.robot, numbers)
        ]
    return out


def columns(linear: Linear, candidate: Candidate, point: int, sizes: np.ndarray | None = None) -> np.ndarray:
    """How the residuals change with an effect's sizes, whitened, (r, s) per unit of each size.

    Args:
        point: of the candidate's grid. sizes: about which; zero if None.
    """
    smooth, effect = linear.smooth, candidate.effect
    if not effect.sizes:
        return np.zeros((len(linear.white.rows), 0))
    start = np.zeros(len(effect.sizes)) if sizes is None else sizes
    before = _removed(smooth, candidate, start, point)
    out = []
    for k, prior in enumerate(candidate.prior):
        step = STEP * prior
        after = _removed(smooth, candidate, start + step * (np.arange(len(start)) == k), point)
        if after.tree is before.tree and after.cells is before.cells:
            change = (packed(after) - packed(before)) / step
            raw = (linear.white.sensitivity @ change[..., None])[..., 0]
        else:
            raw = (residuals(after, linear.theta) - residuals(before, linear.theta)) / step
        out.append(-raw)
    return linear.white(np.stack(out, axis=-1))


def whole_change(linear: Linear, candidate: Candidate, point: int) -> np.ndarray:
    """How the residuals change with an effect that has no size: it is there or not, whitened, (r, 1)."""
    after = _removed(linear.observed, candidate, np.zeros(0), point)
    return linear.white(residuals(linear.observed, linear.theta) - residuals(after, linear.theta))[:, None]


def _removed(smooth: Observation, candidate: Candidate, sizes: np.ndarray, point: int) -> Observation:
    return candidate.effect.predict(smooth, candidate.target, candidate.values(sizes, point))
