"""An effect that is there: which, on what, how large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tulip_testbed.effects.effect import Effect, Values
from tulip_testbed.effects.targets import check_target
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot

MOST_PRIORS = 100.0  # a size beyond this many of its prior's s.d. is a wrong unit


@dataclass(frozen=True)
class EffectInstance:
    """One effect of a laboratory, hidden or adopted.

    Attributes:
        target: "" where the effect is of the whole.
        values: of its parameters, in order [SI].
        intervals: 95 % interval of each value, None where it is not an estimate; empty: of none.
    """

    effect: Effect
    target: str
    values: Values
    intervals: tuple[tuple[float, float] | None, ...] = ()

    @property
    def choices(self) -> list[float]:
        """The values that name one of several things."""
        return [v for p, v in zip(self.effect.parameters, self.values, strict=True) if p.choices]

    def document(self) -> dict[str, Any]:
        """For JSON: name, target (None: the whole) and parameters [SI]."""
        intervals = self.intervals or (None,) * len(self.values)
        return {
            "name": self.effect.name,
            "target": self.target or None,
            "parameters": [
                {
                    "name": parameter.name,
                    "value": value,
                    "unit": parameter.unit,
                    "low95": None if interval is None else interval[0],
                    "high95": None if interval is None else interval[1],
                }
                for parameter, value, interval in zip(
                    self.effect.parameters, self.values, intervals, strict=True
                )
            ],
        }


def injected(rig: Rig, instances: Sequence[EffectInstance]) -> Rig:
    """The laboratory with these effects, in the order in which they act (`Effect.stage`)."""
    for found in _in_turn(instances):
        rig = found.effect.inject(rig, found.target, found.values)
    return rig


def removed(observed: Observation, instances: Sequence[EffectInstance]) -> Observation:
    """What was observed, freed of these effects: the last to act first, since it acted upon the others."""
    for found in reversed(_in_turn(instances)):
        observed = found.effect.predict(observed, found.target, found.values)
    return observed


def _in_turn(instances: Sequence[EffectInstance]) -> list[EffectInstance]:
    return sorted(instances, key=lambda found: found.effect.stage)


def check_instance(found: EffectInstance, robot: Robot, placements: Sequence[int], where: str) -> None:
    """Refuse a target or a value that makes no sense.

    Args:
        placements: of the experiment.

    Raises:
        InputError: names what was found and what is valid.
    """
    effect = found.effect
    valid = effect.targets.of(robot, tuple(int(p) for p in placements))
    check_target(effect.targets, found.target, valid, where)
    for parameter, value in zip(effect.parameters, found.values, strict=True):
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        here = f"{where}: {effect.name}, {parameter.name}{unit}: found {value:g}"
        if not np.isfinite(value):
            raise InputError(f"{here}, expected a finite number")
        if parameter.positive and value < 0:
            raise InputError(f"{here}, expected 0 or more")
        if parameter.choices:
            if value not in range(len(parameter.choices)):
                raise InputError(f"{here}, expected 0 to {len(parameter.choices) - 1}")
        elif parameter.grid and not min(parameter.grid) <= value <= max(parameter.grid):
            raise InputError(f"{here}, expected within [{min(parameter.grid):g}, {max(parameter.grid):g}]")
        if parameter.prior > 0 and abs(value) > MOST_PRIORS * parameter.prior:
            most = MOST_PRIORS * parameter.prior
            raise InputError(f"{here}, expected at most {most:.3g} in size (SI units: rad, m, N, kg)")
    if len(chosen := found.choices) > len(set(chosen)):
        raise InputError(f"{where}: {effect.name}: found the same choice twice, expected different ones")
