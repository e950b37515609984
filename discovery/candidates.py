"""An effect on a target, before and after its sizes are fitted."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from tulip_testbed.base.result import InMemory
from tulip_testbed.effects.catalogue import NamedEffect, catalogue, targets_in
from tulip_testbed.effects.effect import Effect, Values
from tulip_testbed.effects.instance import EffectInstance, effect_label
from tulip_testbed.identification.noise_structure import groups
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import center

MOST_PLACEMENTS = 100  # that are sought for errors one by one


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect on a target, before a fit.

    Attributes:
        settings: values of all parameters with the sizes zero, one row for each point of the grid, (g, k).
        price: ln of the number of hypotheses among which it was chosen before, in addition to
            the points of the grid.
    """

    effect: NamedEffect
    target: str
    settings: InMemory[np.ndarray]
    price: InMemory[float] = 0.0

    @property
    def label(self) -> str:
        """Return `name:target`."""
        return effect_label(self.effect.name, self.target)

    @cached_property
    def prior(self) -> np.ndarray:
        """Return the prior standard deviation of each size, (s,)."""
        parameters = self.effect.parameters_on(self.target)
        return np.array([parameters[k].prior for k in self.effect.sizes])

    @cached_property
    def positive(self) -> np.ndarray:
        """Return which sizes cannot be negative, (s,) bool."""
        return np.array([self.effect.parameters[k].positive for k in self.effect.sizes], bool)

    @property
    def time_parameter(self) -> int | None:
        """Return the index of the parameter that is a time of the experiment; None: it has none."""
        timed = [k for k, p in enumerate(self.effect.parameters) if p.grid and not p.choices]
        return timed[0] if timed else None

    def at_sizes(self, multiples: Sequence[float]) -> Candidate:
        """Return it with multiples of the plausible sizes on its grid, instead of sizes to be estimated."""
        sizes = dict(zip(self.effect.sizes, np.outer(self.prior, multiples).tolist(), strict=True))
        parameters = enumerate(self.effect.parameters)
        chosen = tuple(replace(p, grid=tuple(sizes[k])) if k in sizes else p for k, p in parameters)
        settings = np.array(list(product(*(p.grid or (0.0,) for p in chosen))))
        return replace(self, effect=replace(self.effect, parameters=chosen), settings=settings)

    def values(self, sizes: np.ndarray, point: int = 0) -> Values:
        """Return the values of all parameters for given sizes, (s,), at a point of the grid."""
        values = self.settings[point].tolist()
        for k, size in zip(self.effect.sizes, sizes, strict=True):
            values[k] = float(size)
        return tuple(values)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A candidate at a point of its grid, with fitted sizes.

    Attributes:
        sizes: estimates, (s,).
        log_bayes_factor: ln of the Bayes factor against the same model without the effect; minus infinity:
            the experiment cannot show the effect.
        p: probability of as large a decrease of chi-square without the effect, at this point alone.
        visible: change of the residuals by one prior s.d. over their noise, at the point of the grid and in
            the direction of the sizes where it is largest.
    """

    candidate: Candidate
    point: int
    sizes: np.ndarray
    log_bayes_factor: float = np.nan
    p: float = np.nan
    visible: float = np.nan

    @property
    def label(self) -> str:
        """Return `name:target`."""
        return self.candidate.label

    @property
    def key(self) -> Hashable:
        """Return what tells it from others: at another point, as of other cells, an effect is another one."""
        return self.label, self.candidate.settings[self.point].tobytes()

    @property
    def detectable(self) -> bool:
        """Whether the experiment can show the effect at a plausible size."""
        return self.log_bayes_factor > -np.inf

    @property
    def values(self) -> Values:
        """Return the values of all parameters."""
        return self.candidate.values(self.sizes, self.point)

    @property
    def instance(self) -> EffectInstance:
        """Return the effect without what only a search needs."""
        return EffectInstance(self.candidate.effect, self.candidate.target, self.values)

    def removed(self, observed: Observation) -> Observation:
        """Return the observation with the effect removed."""
        return self.candidate.effect.remove(observed, self.candidate.target, self.values)


ALONE = ({"right"}, {"left"})  # supports of records on one foot


def candidates(observed: Observation, effects: dict[str, Effect] | None = None) -> list[Candidate]:
    """List every effect on every target that an experiment has; of many placements, those that stand out.

    Args:
        effects: by name; None: those of the catalogue that a search tries.
    """
    numbers, zeros, m = standing_out(observed), observed.contacts.zero_sd, observed.measurements
    out, no_weight = [], m.weighed_mass is None and set(m.support) in ALONE
    known = {name: one for name, one in catalogue().items() if one.searched} if effects is None else effects
    for effect in known.values():
        grids = [parameter.grid or (0.0,) for parameter in effect.parameters]
        settings = np.array(list(product(*grids)), float).reshape(-1, len(grids))
        if effect.name == "wrench-zero" and zeros is not None and zeros.any():
            continue  # they are estimated with the families
        if effect.name == "wrench-gain" and no_weight:
            continue  # the gain and a weight that nobody knows are one
        targets = targets_in(effect, observed.nominal.robot, m.contacts, numbers, m.experiments)
        out += [
            Candidate(effect, target, settings)
            for target in targets
            if not (no_weight and target.endswith(".fz.fz"))
        ]
    return out


def standing_out(observed: Observation) -> tuple[int, ...]:
    """List the placements that may be in error: all, or those whose centre of pressure is off most."""
    placement = observed.measurements.placement
    numbers = np.unique(placement)
    if len(numbers) > MOST_PLACEMENTS:
        together, matrix = groups(placement), observed.geometry.regressor
        flat, output = matrix.reshape(-1, matrix.shape[2]), center(observed)
        left = output - matrix @ np.linalg.lstsq(flat, output.ravel(), rcond=None)[0]
        off = (together.sums(left) ** 2).sum(axis=1) / together.sums(np.ones(len(left)))
        numbers = np.sort(numbers[np.argsort(-off)[:MOST_PLACEMENTS]])
    return tuple(numbers.tolist())


def change_times(candidate: Candidate, observed: Observation) -> np.ndarray:
    """Compute the times at which a change would lie between two successive postures, within the grid, (t,).

    Empty where the effect does not change in time.
    """
    timed = candidate.time_parameter
    if timed is None:
        return np.zeros(0)
    time, grid = np.unique(observed.time_fraction), candidate.effect.parameters[timed].grid
    # A change at an end of the grid lies between the postures on both sides of it.
    inside = (time[1:] >= min(grid)) & (time[:-1] < max(grid))
    return np.clip((time[1:] + time[:-1]) / 2, min(grid), max(grid))[inside]


def log_choices(candidate: Candidate, observed: Observation) -> float:
    """Compute ln of the number of hypotheses among which a fit chooses: times of a change, or grid points."""
    timed = candidate.time_parameter
    if timed is None or candidate.effect.parameters[timed].smooth:
        return candidate.price + float(np.log(len(candidate.settings)))
    return float(np.log(len(change_times(candidate, observed)) or len(candidate.settings)))
