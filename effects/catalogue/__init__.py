"""The catalogue of physical effects: every module of this package that has an `EFFECT` is one."""

from __future__ import annotations

import copyreg
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from functools import cache
from importlib import import_module
from inspect import cleandoc
from types import MappingProxyType, ModuleType
from typing import Any

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import look_up
from tulip_testbed.base.table import Table
from tulip_testbed.effects.effect import Effect

WIDTH = 150  # characters of the table in plain text: sentences of two lines at most


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
        """Return an effect.

        Raises:
            UnknownNameError: with the names that are close and those that are valid.
        """
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
    effects = [module.EFFECT for module in _modules() if hasattr(module, "EFFECT")]
    return Catalogue(sorted(effects, key=lambda effect: effect.name))


def explanation(name: str) -> str:
    """Return the physics of an effect of the catalogue, as its module describes it.

    Raises:
        UnknownNameError: with the names that are close and those that are valid.
    """
    effect = catalogue()[name]
    (text,) = (m.__doc__ for m in _modules() if getattr(m, "EFFECT", None) is effect)
    return cleandoc(text or "")


def _modules() -> Iterator[ModuleType]:
    return (import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))


def _by_name(name: str) -> Effect:
    return catalogue()[name]


def _pickled(effect: Effect) -> tuple[Callable[..., Effect], tuple[Any, ...]]:
    """Pickle an effect of the catalogue by its name: its targets are functions without one."""
    if catalogue().get(effect.name) is effect:
        return _by_name, (effect.name,)
    return Effect, tuple(getattr(effect, field.name) for field in fields(effect))


copyreg.pickle(Effect, _pickled)
