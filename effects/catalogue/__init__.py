"""The catalogue of physical effects: one file each, found by its place here."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from inspect import cleandoc
from types import ModuleType

from tulip_testbed.effects.effect import Effect


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by name, in alphabetical order; a module of this package that has an EFFECT is one."""
    effects = [module.EFFECT for module in _modules() if hasattr(module, "EFFECT")]
    return {effect.name: effect for effect in sorted(effects, key=lambda effect: effect.name)}


def explanation(name: str) -> str:
    """The physics of an effect of the catalogue, as its module tells it."""
    (text,) = (m.__doc__ for m in _modules() if getattr(m, "EFFECT", None) is catalogue()[name])
    return cleandoc(text or "")


def _modules() -> Iterator[ModuleType]:
    return (import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
