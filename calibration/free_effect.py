"""An effect that is estimated with the families but belongs to none of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.size_prior import log_tail, prior_sd


@dataclass(frozen=True)
class FreeEffect:
    """An effect whose sizes have the prior of `size_prior`, not that of a family.

    Attributes:
        start: the effect at the sizes where the estimate begins; times and choices stay as they are.
    """

    start: EffectInstance

    @property
    def effect(self) -> Effect:
        """Return the kind."""
        return self.start.effect

    @property
    def name(self) -> str:
        """Return the name of the kind."""
        return self.effect.name

    @property
    def targets(self) -> tuple[str, ...]:
        """Return its target."""
        return (self.start.target,)

    @property
    def sizes(self) -> np.ndarray:
        """Return the sizes at the start, (n,) [SI]."""
        return np.array([self.start.values[k] for k in self.effect.sizes])

    @property
    def steps(self) -> np.ndarray:
        """Return the plausible size of every size, (n,) [SI]."""
        parameters = self.effect.parameters_on(self.start.target)
        return np.array([parameters[k].prior for k in self.effect.sizes])

    @property
    def center(self) -> np.ndarray:
        """Return the mean of the prior of every size, (n,) [SI]."""
        return np.zeros(len(self))

    @property
    def prior_sd(self) -> np.ndarray:
        """Return the s.d. of the normal distribution in place of the prior at the start, (n,) [SI]."""
        return prior_sd(self.steps, self.sizes)

    @property
    def log_tail(self) -> float:
        """Return what ln of the evidence gains by the tails of the prior, see `size_prior`."""
        return float(log_tail(self.steps, self.sizes).sum())

    def __len__(self) -> int:
        return len(self.effect.sizes)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the name of every size, as a family names its numbers."""
        names = list(self.start.named_values)
        return tuple(names[k] for k in self.effect.sizes)

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        """Return how the sizes arise from independent deviates of s.d. 1, (n, n) [SI]."""
        return (np.diag(self.prior_sd),) if len(self) else ()

    def instances(self, values: np.ndarray) -> list[EffectInstance]:
        """Return the effect with these sizes, (n,)."""
        filled = list(self.start.values)
        for k, value in zip(self.effect.sizes, values.tolist(), strict=True):
            filled[k] = value
        return [replace(self.start, values=tuple(filled), intervals=())]

    def at(self, sizes: np.ndarray) -> FreeEffect:
        """Return it with these sizes as its start, (n,)."""
        return FreeEffect(self.instances(sizes)[0])

    def single(self, number: int, more: float) -> EffectInstance:
        """Return the effect at the sizes of the start, one of them larger by so much."""
        values = self.sizes
        values[number] += more
        return self.instances(values)[0]
