"""The catalogue of physical effects: one file each, found by its place here."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

from experiments.effects.effect import Effect


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by name, in alphabetical order; a module of this package that has an EFFECT is one."""
    modules = (import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
    effects = [module.EFFECT for module in modules if hasattr(module, "EFFECT")]
    return {effect.name: effect for effect in sorted(effects, key=lambda effect: effect.name)}
