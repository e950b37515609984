"""An effect: one physical cause that the nominal model lacks, with its simulation and its removal."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from tulip_testbed.base.errors import listed
from tulip_testbed.base.numbers import number
from tulip_testbed.effects.lasting import ALWAYS, Lasting, Values, by_experiment
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.targets import WHOLE, Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig

# Factor and unit in which a value is shown, by its SI unit; "" is a ratio.
DISPLAY = {
    "": (100.0, "%"),
    "rad": (180 / math.pi, "deg"),
    "rad/Nm": (180 / math.pi, "deg/Nm"),
    "rad s/Nm": (180 / math.pi, "deg s/Nm"),
    "rad/N": (1e3 * 180 / math.pi, "deg/kN"),
    "m": (1e3, "mm"),
}


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name, unit: SI unit; "" for a ratio.
        prior: standard deviation of the values that are plausible in a careful laboratory [unit].
        positive: whether negative values are impossible.
        grid: the values that a search tries where the effect is not linear in the parameter (a time, a
            choice). Empty for a size, which is estimated.
        choices: names of the values 0, 1, ... if the parameter chooses one of several things.
        smooth: whether neighbouring values of the grid predict much the same. A search may then look between
            them without choosing among more hypotheses.
        fixed: whether it is part of what the effect is, such as the place of a step or the range in which a
            law was learned: chosen before a fit, and no time of the experiment.
    """

    name: str
    unit: str
    prior: float = 0.0
    positive: bool = False
    grid: tuple[float, ...] = ()
    choices: tuple[str, ...] = ()
    smooth: bool = False
    fixed: bool = False

    @property
    def placeholder(self) -> str:
        """Return the name as it stands for a value in a usage text."""
        return self.name.upper().replace(" ", "_")

    @property
    def heading(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def display(self) -> tuple[float, str]:
        """Return the factor from SI units and the unit in which values are shown."""
        return DISPLAY.get(self.unit, (1.0, self.unit))

    @property
    def plausible(self) -> str:
        if self.grid:
            return f"one of {listed(self.text(value) for value in self.grid)}"
        sign = ", not negative" if self.positive else ""
        return f"s.d. {self.text(self.prior)}{sign}"

    def text(self, value: float, interval: tuple[float, float] | None = None) -> str:
        """Write a value [SI] with its unit, and ± the longer half of its 95 % interval if there is one."""
        if self.choices:
            return self.choices[round(value)].replace("_", " ")
        factor, unit = self.display
        if interval is None:
            return f"{number(factor * value, '.3g')} {unit}".strip()
        # The shorter half of an interval may have been cut at zero.
        half = factor * max(interval[1] - value, value - interval[0])
        digits = max(0, 1 - math.floor(math.log10(half))) if half > 0 else 3
        size, half_width = (number(x, f".{digits}f") for x in (factor * value, half))
        return f"{size} ± {half_width} {unit}".strip()


@dataclass(frozen=True)
class Physics:
    """An effect on the robot or its surroundings.

    Attributes:
        inject: (rig, target, values) -> the laboratory with the effect.
        remove: (observation, target, values) -> the observation with the effect removed. It knows the
            measurements and the nominal robot only and shares no formula with `inject`.
        unsure: (observation, target, values) -> the same with every posture off by one s.d. of what its
            readings do not show, for instance where in its play a joint without load rests; None: they show
            all.
    """

    inject: Callable[[Rig, str, Values], Rig]
    remove: Callable[[Observation, str, Values], Observation]
    unsure: Callable[[Observation, str, Values], Observation] | None = None


@dataclass(frozen=True, repr=False)
class Effect:
    """One entry of the catalogue.

    Attributes:
        name: of the kind, as in `name:target=values`.
        sentence: what it is.
        parameters: its numbers, in order.
        mechanism: how it is simulated and how it is removed from an observation.
        words: a finding as a sentence, with {target}, and {0}, {1}, ... for the values and their intervals.
        targets: what it can act on.
        instrument: on which contact sensors it acts: "cells", "plates" (on the ground, of any kind),
            "wrenches", "feet" (wrench sensors in the feet); "" if it acts with any of them.
        statics: whether the static laboratory can simulate it; otherwise only the full dynamics can.
        lasting: how long it stays the same.
        unit_on: target -> unit of the first parameter there, and its plausible size over that of the
            parameter, where targets differ in them; None: they do not.
        searched: whether a search tries it and a random draw may be it; otherwise it has to be named.
        explanation: its physics, with the assumptions.
    """

    name: str
    sentence: str
    parameters: tuple[Parameter, ...]
    mechanism: Physics | Misreading
    words: str
    targets: Targets = WHOLE
    statics: bool = True
    instrument: str = ""
    lasting: Lasting = ALWAYS
    unit_on: Callable[[str], tuple[str, float]] | None = None
    searched: bool = True
    explanation: str = ""

    def __repr__(self) -> str:
        return f"<Effect {self.usage}>"

    @property
    def usage(self) -> str:
        """Return the pattern after which an instance of the effect is written."""
        target = f":{self.targets.word}" if self.targets.word else ""
        return f"{self.name}{target}={','.join(p.placeholder for p in self.parameters)}"

    def parameters_on(self, target: str) -> tuple[Parameter, ...]:
        """Return the parameters with the units and plausible sizes that they have on a target."""
        if self.unit_on is None:
            return self.parameters
        (unit, scale), first = self.unit_on(target), self.parameters[0]
        return (replace(first, unit=unit, prior=scale * first.prior), *self.parameters[1:])

    @property
    def misreads(self) -> bool:
        """Whether the effect changes readings alone."""
        return isinstance(self.mechanism, Misreading)

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Return the indices of the parameters that are estimated; the others are chosen from their grid."""
        return tuple(k for k, p in enumerate(self.parameters) if not p.grid and not p.fixed)

    @property
    def stage(self) -> int:
        """Return when it acts: 0 on the robot, 1 on readings, 2 on which reading has which name."""
        return 0 if not self.misreads else 1 if self.sizes else 2

    @property
    def exchanges(self) -> bool:
        """Whether it exchanges readings: it is undone exactly, by exchanging them again."""
        return self.stage == 2 and self.mechanism.unsure is None

    def refusal(self, values: Values) -> str:
        """Say why these values do not fit each other, "" if they do."""
        return ""

    def told(self, target: str, values: Values, intervals: tuple[tuple[float, float] | None, ...]) -> str:
        """Tell a finding as a sentence, with values ± half of their 95 % intervals, if there are any."""
        texts = [
            parameter.text(value, interval)
            for parameter, value, interval in zip(
                self.parameters_on(target), values, intervals or (None,) * len(values), strict=True
            )
        ]
        return self.words.format(*texts, target=target.replace("_", " ").replace(".", " "))

    def inject(self, rig: Rig, target: str, values: Values) -> Rig:
        """Return the laboratory with the effect; at zero it is unchanged."""
        return self.mechanism.inject(rig, target, values)

    def remove(self, observed: Observation, target: str, values: Values) -> Observation:
        """Return the observation with the effect removed, as the nominal laboratory would have given it."""
        return by_experiment(self, self.mechanism.remove, observed, target, values)

    def unsure(self, observed: Observation, target: str, values: Values) -> Observation | None:
        """Return the observation off by one s.d. of what its readings do not show; None: they show all."""
        if self.mechanism.unsure is None:
            return None
        return by_experiment(self, self.mechanism.unsure, observed, target, values)
