"""Read effects that are asked for by name, and draw random ones."""

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.errors import InputError, at_least, look_up, shortened
from tulip_testbed.effects.catalogue import catalogue, effects_on, targets_in
from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.instance import EffectInstance, check_laboratory, split_label
from tulip_testbed.effects.laws import LAW
from tulip_testbed.measurements.contacts import Contacts
from tulip_testbed.sim.robot import Robot

RANDOM = "random"


def draw_effect(
    robot: Robot,
    placements: Sequence[int],
    rng: np.random.Generator,
    statics: bool,
    contacts: Contacts | None = None,
) -> EffectInstance:
    """Draw an effect, see `read_effects`: kind and target alike, sizes from priors, the rest from a grid."""
    effects = [effect for effect in effects_on(contacts, statics) if effect.searched]
    effect = effects[rng.integers(len(effects))]
    targets = targets_in(effect, robot, contacts, tuple(int(p) for p in placements))
    target = targets[rng.integers(len(targets))]
    parameters = effect.parameters_on(target)
    while True:
        found = EffectInstance(effect, target, tuple(_draw(parameter, rng) for parameter in parameters))
        if len(chosen := found.choices) == len(set(chosen)):
            return found


def _draw(parameter: Parameter, rng: np.random.Generator) -> float:
    if parameter.grid:
        return float(rng.choice(parameter.grid))
    size = parameter.prior * rng.standard_normal()
    return float(abs(size) if parameter.positive else size)


def read_effects(
    texts: Sequence[str],
    robot: Robot,
    placements: Sequence[int],
    seed: int,
    statics: bool,
    where: str = "effect",
    contacts: Contacts | None = None,
) -> tuple[EffectInstance, ...]:
    """Read each text as `name:target=values`; the text `random` draws an effect.

    Args:
        placements: numbers of the experiment's placements.
        seed: of the draws.
        statics: whether the laboratory is static.
        where: place of the texts, for messages.
        contacts: wrench sensors; None: plates on cells.

    Raises:
        InputError: for an effect that cannot be read or that the laboratory cannot simulate.
    """
    at_least("seed", seed, 0)
    # A stream apart from the laboratory's, so that a drawn effect leaves the noise as it was.
    rng = np.random.default_rng(np.random.SeedSequence((seed, 1)))
    found = []
    for text in texts:
        if text == RANDOM:
            found.append(draw_effect(robot, placements, rng, statics, contacts))
            continue
        name, _ = split_label(text.partition("=")[0])
        if name == RANDOM:
            raise InputError(
                f"{where} {shortened(text)}: found a target or values, expected `{RANDOM}` alone"
            )
        look_up("effect", name, [*catalogue(), LAW, RANDOM], where)
        found.append(EffectInstance.parse(text, robot, placements, where))
        check_laboratory(found[-1], statics, f"{where} {shortened(text)}")
    return tuple(found)
