"""Find which column of a laboratory's table is which of the contract's, by its name and no more."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from tulip_testbed.base.errors import listed
from tulip_testbed.measurements.column_mapping import UNITS, MappingEntry, quantity_of

BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
BORDERS = re.compile(r"[^A-Za-z0-9]+|(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
SAME = {"l": "left", "r": "right", "t": "time", "timestamp": "time", "cmd": "command", "sd": "std"}
MARKS = frozenset({"std", "command", "motor", "cop", "plate"})  # wherever in a name they are written
FILLING = {
    *("q", "wrench", "cell", "joint", "angle", "position", "force", "moment", "torque", "sensor"),
    *("foot", "sole", "ft", "fts", "measured"),
}
WRITTEN = {"n m": "Nm", "n.m": "Nm", "n*m": "Nm", "\u00b0": "deg", "m/s^2": "m/s2", "m/s\u00b2": "m/s2"}
KNOWN = {unit.lower(): unit for units in UNITS.values() for unit in units} | WRITTEN
# Written after an underscore.
ENDS = ("rad_s", "deg_s", "rad", "deg", "mm", "ms", "us", "ns", "kg", "kgf", "kN", "Nm", "N", "s", "m")


class Proposal(NamedTuple):
    """A proposed mapping.

    Attributes:
        mapping: by the contract's names; columns that have them already are not listed.
        exact: the contract's names that the table has.
        undecided: what the user has to say, one sentence each. silent: columns that are not used, since
            their names write no unit.
        unused: columns of the table that nothing was found for.
    """

    mapping: dict[str, MappingEntry]
    exact: list[str]
    undecided: list[str]
    silent: list[str]
    unused: list[str]


def propose(
    columns: Sequence[str], names: Sequence[str], required: Sequence[str], stated: dict[str, MappingEntry]
) -> Proposal:
    """Propose a mapping: what is stated, exact names, then names of the same words in the same order.

    A unit is taken from the column's name; without one the column is not mapped. Signs are +1.

    Args:
        columns: of the table. names: all of the contract's. required: those of them that are necessary.
        stated: what the user says.
    """
    mapping, undecided, silent = dict(stated), [], []
    used = {entry.column for entry in stated.values()}
    exact = [name for name in names if name in columns and name not in used and name not in stated]
    free = {column: split_unit(column) for column in columns if column not in (*used, *exact)}
    by_words: dict[object, list[str]] = {}
    for column, (bare, _) in free.items():
        by_words.setdefault(_words(bare), []).append(column)
    for name in [name for name in names if name not in stated and name not in exact]:
        matches, units = by_words.get(_words(name), []), UNITS.get(quantity_of(name) or "", {})
        if len(matches) > 1 and name in required:
            undecided.append(f"{name}: columns {listed(map(repr, matches))} could be it; state one")
        if len(matches) != 1:
            continue
        (column,), unit = matches, free[matches[0]][1]
        if not units or unit in units:
            mapping[name] = MappingEntry(column=column, unit=unit if units else None)
        elif name in required:
            written = f"has the unit '{unit}'" if unit else "has no unit in its name"
            undecided.append(f"{name}: column '{column}' {written}; state one of {listed(units)}")
        else:
            silent.append(column)
    taken = {entry.column for entry in mapping.values()}
    unused = [column for column in free if column not in taken and column not in silent]
    return Proposal(mapping, exact, undecided, silent, unused)


def split_unit(name: str) -> tuple[str, str]:
    """Split the name of a column from its unit: one of the contract's, another text, or "" for none."""
    if in_brackets := BRACKETS.match(name):
        bare, unit = in_brackets.groups()
        return bare, KNOWN.get(unit.strip().lower(), unit.strip())
    end = next((end for end in ENDS if name.endswith(f"_{end}")), "")
    return name.removesuffix(f"_{end}"), KNOWN.get(end.lower().replace("_", "/"), "")


def _words(text: str) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return the words of a name that tell it from others: marks, and the rest in their order."""
    words = [SAME.get(word.lower(), word.lower()) for word in BORDERS.split(text) if word]
    return MARKS.intersection(words), tuple(word for word in words if word not in MARKS | FILLING)


def with_units(stated: dict[str, MappingEntry]) -> dict[str, MappingEntry]:
    """Return stated columns with the units that their names write, where no unit is stated."""
    out = {}
    for name, entry in stated.items():
        unit, quantity = split_unit(entry.column)[1], quantity_of(name)
        written = entry.unit is None and quantity is not None and unit in UNITS[quantity]
        out[name] = entry.model_copy(update={"unit": unit}) if written else entry
    return out
