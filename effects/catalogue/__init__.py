"""The catalogue of physical effects: every module of this package that has an `EFFECT` is one."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from functools import cache
from html import escape
from importlib import import_module
from inspect import cleandoc
from textwrap import wrap
from types import ModuleType

from tulip_testbed.effects.effect import Effect

HEADERS = ("effect", "unit", "plausible size", "what it is")
LINE = 60  # characters of the last column in plain text


class Catalogue(dict[str, Effect]):
    """Effects by name; shown as a table."""

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return the usage of every effect, its units, plausible sizes and what it is."""
        return [
            (
                effect.usage,
                ", ".join(p.unit or "-" for p in effect.parameters),
                "; ".join({p.plausible: p for p in effect.parameters if not p.grid}) or "a choice",
                effect.sentence + ("" if effect.statics else " Full dynamics only."),
            )
            for effect in self.values()
        ]

    def __repr__(self) -> str:
        table = [HEADERS, *self.rows()]
        widths = [max(len(row[k]) for row in table) for k in range(len(HEADERS) - 1)]
        lines = []
        for *cells, sentence in table:
            start = "".join(cell.ljust(width + 2) for cell, width in zip(cells, widths, strict=True))
            lines += wrap(
                sentence, len(start) + LINE, initial_indent=start, subsequent_indent=len(start) * " "
            )
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in row)}</tr>"
            for tag, row in [("th", HEADERS), *(("td", row) for row in self.rows())]
        )
        return f"<table>{rows}</table>"


@cache
def catalogue() -> Catalogue:
    """Return all effects by name, in alphabetical order."""
    effects = [module.EFFECT for module in _modules() if hasattr(module, "EFFECT")]
    return Catalogue({effect.name: effect for effect in sorted(effects, key=lambda effect: effect.name)})


def explanation(name: str) -> str:
    """Return the physics of an effect of the catalogue, as its module describes it."""
    (text,) = (m.__doc__ for m in _modules() if getattr(m, "EFFECT", None) is catalogue()[name])
    return cleandoc(text or "")


def _modules() -> Iterator[ModuleType]:
    return (import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
