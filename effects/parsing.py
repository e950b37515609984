"""Effects to hide in simulated data: read from the command line, or drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.effect import Effect, Parameter
from tulip_testbed.effects.instance import EffectInstance, check_instance
from tulip_testbed.effects.wording import spoken
from tulip_testbed.sim.errors import InputError, listed, look_up, shortened
from tulip_testbed.sim.robot import Robot

RANDOM = "random"
DOUBTFUL = 10.0  # prior s.d.


def usage(effect: Effect) -> str:
    """How an effect is written on the command line."""
    target = f":{effect.targets.word}" if effect.targets.word else ""
    return f"{effect.name}{target}={','.join(p.name.upper().replace(' ', '_') for p in effect.parameters)}"


def read_effect(
    text: str, robot: Robot, placements: Sequence[int], where: str = "--effect"
) -> EffectInstance:
    """Read NAME[:TARGET]=VALUE[,VALUE...]; values in SI units, choices by name.

    Args:
        placements: of the experiment.

    Raises:
        InputError: names what is wrong and what is valid.
    """
    head, equals, tail = text.partition("=")
    name, _, target = head.partition(":")
    effect = catalogue()[look_up("effect", name, [*catalogue(), RANDOM], where)]
    where = f"{where} {shortened(text)}"
    values = tail.split(",") if equals else []
    if len(values) != len(effect.parameters):
        raise InputError(
            f"{where}: found {len(values)} values, expected {len(effect.parameters)}: {usage(effect)}"
        )
    numbers = [_number(v, p, where) for v, p in zip(values, effect.parameters, strict=True)]
    found = EffectInstance(effect, target, tuple(numbers))
    check_instance(found, robot, placements, where)
    return found


def _number(text: str, parameter: Parameter, where: str) -> float:
    if parameter.choices:
        return float(parameter.choices.index(look_up(parameter.name, text.strip(), parameter.choices, where)))
    try:
        return float(text)
    except ValueError:
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        raise InputError(
            f"{where}: {parameter.name}: found '{shortened(text)}', expected a number{unit}"
        ) from None


def draw_effect(
    robot: Robot, placements: Sequence[int], rng: np.random.Generator, statics: bool
) -> EffectInstance:
    """Kind and target with equal chances, each size from its prior, the rest from its grid.

    Args:
        statics: only what the static laboratory knows.
    """
    effects = [effect for effect in catalogue().values() if effect.statics or not statics]
    effect = effects[rng.integers(len(effects))]
    targets = effect.targets.of(robot, tuple(int(p) for p in placements))
    target = targets[rng.integers(len(targets))]
    while True:
        found = EffectInstance(
            effect, target, tuple(_draw(parameter, rng) for parameter in effect.parameters)
        )
        if len(chosen := found.choices) == len(set(chosen)):
            return found


def _draw(parameter: Parameter, rng: np.random.Generator) -> float:
    if parameter.grid:
        return float(rng.choice(parameter.grid))
    size = parameter.prior * rng.standard_normal()
    return float(abs(size) if parameter.positive else size)


def read_effects(
    texts: Sequence[str], robot: Robot, placements: Sequence[int], seed: int, statics: bool
) -> tuple[EffectInstance, ...]:
    """All effects of a command line; `random` draws one.

    Args:
        seed: of the draws.
        statics: whether they are for the static laboratory.

    Raises:
        InputError: an effect that cannot be read, or that this laboratory does not know.
    """
    # Apart from the laboratory's own streams: what is hidden leaves the noise as it was.
    rng = np.random.default_rng(np.random.SeedSequence((seed, 1)))
    found = []
    for text in texts:
        if text == RANDOM:
            found.append(draw_effect(robot, placements, rng, statics))
        else:
            found.append(read_effect(text, robot, placements))
            check_laboratory(found[-1], statics, f"--effect {shortened(text)}")
    return tuple(found)


def doubts(found: EffectInstance) -> list[str]:
    """What is far beyond plausible: most often another unit was meant."""
    label = f"{found.effect.name}:{found.target}" if found.target else found.effect.name
    return [
        f"{label}: {p.name} {value:g} {p.unit} ({spoken(p, value)}) is {abs(value) / p.prior:.0f} times what "
        f"is plausible ({p.prior:.3g} {p.unit}); values are in SI units"
        for p, value in zip(found.effect.parameters, found.values, strict=True)
        if p.prior and abs(value) > DOUBTFUL * p.prior
    ]


def check_laboratory(found: EffectInstance, statics: bool, where: str) -> None:
    """Refuse what acts in the full dynamics alone.

    Raises:
        InputError: names what the static laboratory knows.
    """
    if statics and not found.effect.statics:
        known = listed(effect.name for effect in catalogue().values() if effect.statics)
        raise InputError(
            f"{where}: found {found.effect.name}, which acts in the full dynamics alone; "
            f"the static laboratory knows {known}"
        )
