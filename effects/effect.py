"""An effect: a physical cause that the nominal model lacks, defined once for both sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tulip_testbed.effects.targets import WHOLE, Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig

Values = tuple[float, ...]


@dataclass(frozen=True)
class Parameter:
    """A number of an effect.

    Attributes:
        name, unit: SI; "" for a ratio.
        prior: physically plausible size, the s.d. of its prior [unit].
        positive: whether it cannot be negative.
        grid: values at which a search tries it, for what cannot be linearised (a time, a choice);
            empty: a size, which is estimated.
        choices: names of the values 0, 1, ... of a choice.
    """

    name: str
    unit: str
    prior: float = 0.0
    positive: bool = False
    grid: tuple[float, ...] = ()
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Attributes:
        name: as in `tulip simulate --effect NAME:TARGET=VALUE`.
        sentence: what it is, for a person.
        parameters: its numbers, in order.
        inject: (rig, target, values) -> rig: changes the physics or the instruments of the laboratory.
        predict: (observation, target, values) -> observation with the effect removed: what the nominal
            laboratory would have shown instead.
        words: of a finding, with {target} and {0}, {1}, ... for the values with their intervals.
        targets: what it may concern.
        statics: whether the static laboratory knows it; else only the full dynamics does.
        misreads: whether instruments alone are at fault, whatever stands there.
    """

    name: str
    sentence: str
    parameters: tuple[Parameter, ...]
    inject: Callable[[Rig, str, Values], Rig]
    predict: Callable[[Observation, str, Values], Observation]
    words: str
    targets: Targets = WHOLE
    statics: bool = True
    misreads: bool = False

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of the parameters that are estimated; the others are chosen from their grid."""
        return tuple(k for k, parameter in enumerate(self.parameters) if not parameter.grid)

    @property
    def stage(self) -> int:
        """When it acts: 0 on the robot, 1 on what is read of it, 2 on which reading is said to be which."""
        return 0 if not self.misreads else 1 if self.sizes else 2
