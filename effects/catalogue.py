"""The catalogue of physical effects, and which of them an experiment can have."""

from __future__ import annotations

import copyreg
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from functools import cache
from inspect import cleandoc
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import PlainSerializer, PlainValidator

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError, listed, look_up
from tulip_testbed.base.table import Table
from tulip_testbed.effects import cell, encoder, foot, joint, link, plate, surroundings, wrench
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.lasting import split_target, targets_over
from tulip_testbed.effects.motion_effects import MOTION_EFFECTS
from tulip_testbed.effects.targets import WRENCH_CHANNELS, WRENCH_PAIRS
from tulip_testbed.measurements.contacts import Contacts
from tulip_testbed.measurements.manipulations import Experiment
from tulip_testbed.sim.robot import Robot

SOURCES = (cell, encoder, foot, joint, link, plate, surroundings, wrench)
WIDTH = 150  # characters of the table in plain text: sentences of two lines at most
# Where the sensors on which an effect acts are mounted; None: cells under plates.
MOUNTS = {"cells": (None,), "plates": (None, "ground"), "wrenches": ("ground", "foot"), "feet": ("foot",)}


class Catalogue(Mapping[str, Effect]):
    """Effects by name; shown as a table. Nobody can change it: all share one."""

    def __init__(self, effects: Iterable[Effect]):
        self._effects = MappingProxyType({effect.name: effect for effect in effects})

    def __iter__(self) -> Iterator[str]:
        return iter(self._effects)

    def __len__(self) -> int:
        return len(self._effects)

    def __reduce__(self) -> tuple[Callable[..., Catalogue], tuple[Any, ...]]:
        return (catalogue, ()) if self is catalogue() else (Catalogue, (tuple(self.values()),))

    def __getitem__(self, name: str) -> Effect:
        """Return an effect; refuse an unknown name with the valid ones."""
        return self._effects[look_up("effect", name, self._effects, "effects")]

    def table(self) -> Table:
        """Return the usage of every effect, its units, plausible sizes and what it is."""
        columns = tuple(map(Column, ("effect", "unit", "plausible size", "what it is")))
        rows = [
            (
                effect.usage,
                ", ".join(p.unit or "-" for p in effect.parameters),
                "; ".join({p.plausible: p for p in effect.parameters if not p.grid}) or "a choice",
                effect.sentence + ("" if effect.statics else " Full dynamics only."),
            )
            for effect in self.values()
        ]
        return Table("Effects; values are given in SI units", columns, rows)

    def __repr__(self) -> str:
        return self.table().text(WIDTH)

    def _repr_html_(self) -> str:
        return self.table().html()


@cache
def catalogue() -> Catalogue:
    """Return all effects by name, in alphabetical order."""
    effects = [effect for source in SOURCES for effect in source.EFFECTS]
    return Catalogue(sorted(effects, key=lambda effect: effect.name))


@cache
def every_effect() -> Catalogue:
    """Return the catalogue with the effects that are estimated but cannot be simulated."""
    return Catalogue((*catalogue().values(), *MOTION_EFFECTS))


def explanation(name: str) -> str:
    return cleandoc(catalogue()[name].explanation)


def _by_name(name: str) -> Effect:
    return every_effect()[name]


def _pickled(effect: Effect) -> tuple[Callable[..., Effect], tuple[Any, ...]]:
    """Pickle an effect of the catalogue by its name: its targets are functions without one."""
    if every_effect().get(effect.name) is effect:
        return _by_name, (effect.name,)
    return Effect, tuple(getattr(effect, field.name) for field in fields(effect))


copyreg.pickle(Effect, _pickled)


def acts_on(effect: Effect, contacts: Contacts | None) -> bool:
    """Return whether an effect acts on such contact sensors; None: plates on four cells each."""
    mount = None if contacts is None else contacts.mount
    return not effect.instrument or mount in MOUNTS[effect.instrument]


def effects_on(contacts: Contacts | None, statics: bool = False) -> list[Effect]:
    """List the effects that act on such contact sensors, and in statics those that it can simulate."""
    return [e for e in catalogue().values() if acts_on(e, contacts) and (e.statics or not statics)]


def check_instrument(effect: Effect, contacts: Contacts | None, where: str) -> None:
    """Refuse an effect on sensors that a laboratory does not have."""
    if not acts_on(effect, contacts):
        sensors = "plates on cells" if contacts is None else f"wrench sensors ({contacts.mount})"
        raise InputError(
            f"{where}: found {effect.name} in a laboratory with {sensors}; expected one of "
            f"{listed(one.name for one in effects_on(contacts))}"
        )


def targets_in(
    effect: Effect,
    robot: Robot,
    contacts: Contacts | None,
    placements: tuple[int, ...],
    experiments: tuple[Experiment, ...] = (),
) -> tuple[str, ...]:
    """List the targets that an effect has in an experiment, or in some that were joined."""
    if not acts_on(effect, contacts):
        return ()
    targets = targets_over(effect, effect.targets.of(robot, placements), experiments)
    if effect.targets not in (WRENCH_CHANNELS, WRENCH_PAIRS) or contacts is None:
        return targets
    read = set(contacts.channels)
    return tuple(target for target in targets if read.issuperset(split_target(target)[0].split(".")[1:]))


# The effect of a family in a document, which holds its name.
NamedEffect = Annotated[
    Effect,
    PlainValidator(lambda name: every_effect()[str(name)]),
    PlainSerializer(lambda effect: effect.name),
]
