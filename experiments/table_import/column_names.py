"""Propose which column of a laboratory's table is which of the contract's, by their names alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from tulip_testbed.base.errors import listed
from tulip_testbed.measurements.column_mapping import UNITS, MappingEntry, quantity_of

BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
BORDERS = re.compile(r"[^A-Za-z0-9]+|(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
SIDES = {"l": "left", "r": "right", "lft": "left", "rgt": "right"}
FILLING = {  # words that do not tell one column from another
    *("q", "joint", "angle", "angles", "position", "pos", "encoder", "mean", "average", "avg"),
    *("measured", "wrench", "sole", "foot", "ft", "fts", "sensor", "force", "moment", "torque", "plate"),
    *("cop", "cell", "max", "maximum", "largest"),
}
COUNTS = {"no", "nr", "num", "number", "id", "index"}  # of a posture or a placement
OTHER_WORDS = {"posture": {"pose"}, "placement": {"stance", "setup"}, "time": {"t", "timestamp", "stamp"}}
SPREAD = {"sd", "std", "stdev", "stddev", "sigma"}
COMMAND = {"command", "commanded", "cmd", "desired", "reference", "ref", "target"}
MOTOR = {"motor"}
SYNONYMS = {
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("deg", "degree", "degrees", "\u00b0"), "deg"),
    **dict.fromkeys(("nm", "n m", "n*m", "n.m"), "Nm"),
    **dict.fromkeys(("nmm", "n mm", "n*mm"), "Nmm"),
    **dict.fromkeys(("n", "newton", "newtons"), "N"),
    **dict.fromkeys(("s", "sec", "second", "seconds"), "s"),
    **dict.fromkeys(("m/s2", "m/s^2", "m/s\u00b2"), "m/s2"),
    **dict.fromkeys(("rad/s", "rad s"), "rad/s"),
    **dict.fromkeys(("deg/s", "deg s"), "deg/s"),
}
KNOWN = {unit.lower(): unit for units in UNITS.values() for unit in units} | SYNONYMS
# Written after an underscore.
ENDS = ("rad_s", "deg_s", "rad", "deg", "mm", "ms", "kg", "kgf", "kN", "Nm", "N", "s", "m")


class Named(NamedTuple):
    """The meaning of a column's name.

    Attributes:
        role: "value", "spread", "command" or "motor".
        words: the others, in no order.
        unit: one of the contract's; "" if none is written, another text as it is written.
        bare: the name without its unit.
    """

    role: str
    words: frozenset[str]
    unit: str
    bare: str


def read_name(name: str) -> Named:
    """Return what the name of a table's column says."""
    bare, unit = name, ""
    if in_brackets := BRACKETS.match(name):
        bare, unit = in_brackets.groups()
        unit = KNOWN.get(unit.strip().lower(), unit.strip())
    else:
        for end in ENDS:
            if name.endswith(f"_{end}"):
                bare, unit = name[: -len(end) - 1], KNOWN[end.lower().replace("_", " ")]
                break
    return Named(*_role_and_words(bare), unit, bare)


def _role_and_words(text: str) -> tuple[str, frozenset[str]]:
    words = [word.lower() for word in BORDERS.split(text) if word]
    role = "value"
    for name, marks in (("spread", SPREAD), ("command", COMMAND), ("motor", MOTOR)):
        if marks & set(words):
            role = name
            words = [word for word in words if word not in marks]
            break
    return role, frozenset(SIDES.get(word, word) for word in words)


ROLES = {"q_std": "spread", "cell_std": "spread", "wrench_std": "spread"}
ROLES |= {"q_command": "command", "motor": "motor"}


def wanted(name: str) -> tuple[str, frozenset[str]]:
    """Return the role and the words of a column of the contract."""
    first, _, rest = name.partition(".")
    return ROLES.get(first, "value"), _role_and_words(rest or first)[1]


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
    """Propose a mapping: what is stated, exact names, then names of the same words.

    A unit is taken from the column's name; without one the column is not mapped. Signs are +1.

    Args:
        columns: of the table. names: all of the contract's. required: those of them that are necessary.
        stated: what the user says.
    """
    mapping, undecided, silent = dict(stated), [], []
    used = {entry.column for entry in stated.values()}
    free = [column for column in columns if column not in used]
    exact = [name for name in names if name in free and name not in mapping]
    read = {column: read_name(column) for column in free if column not in exact}
    found = _claims([name for name in names if name not in mapping and name not in exact], read)
    for name, matches in found.items():
        if len(matches) > 1 and name in required:
            undecided.append(f"{name}: columns {listed(map(repr, matches))} could be it; state one")
        if len(matches) != 1:
            continue
        (column,), quantity = matches, quantity_of(name)
        rivals = [one for one in found if column in found[one] and _fits(one, read[column])]
        if name in rivals and len(rivals) > 1:
            if name in required:
                undecided.append(f"{name}: column '{column}' could be each of {listed(rivals)}; state one")
            continue
        unit, units = read[column].unit, UNITS[quantity] if quantity else {}
        if quantity is None or unit in units:
            mapping[name] = MappingEntry(column=column, unit=unit if quantity else None)
        elif name in required:
            written = f"has the unit '{unit}'" if unit else "has no unit in its name"
            undecided.append(f"{name}: column '{column}' {written}; state one of {listed(units)}")
        else:
            silent.append(column)
    taken = {entry.column for entry in mapping.values()}
    silent = [column for column in silent if column not in taken]
    unused = [column for column in read if column not in taken and column not in silent]
    return Proposal(mapping, exact, undecided, silent, unused)


def _claims(names: Sequence[str], read: dict[str, Named]) -> dict[str, list[str]]:
    """Return the columns that may be each of the contract's.

    A column whose words fit several goes to those of the same order: `left front_right` is one cell's.
    """
    found = {name: _matches(name, read) for name in names}
    for column, named in read.items():
        several = [name for name in names if column in found[name] and _fits(name, named)]
        for core in (False, True):
            if same := [name for name in several if _in_order(name, core) == _in_order(named.bare, core)]:
                for name in set(several) - set(same):
                    found[name].remove(column)
                break
    return found


def _fits(name: str, column: Named) -> bool:
    quantity = quantity_of(name)
    return column.unit in UNITS[quantity] if quantity else not column.unit


def _in_order(text: str, core: bool) -> list[str]:
    words = [SIDES.get(word.lower(), word.lower()) for word in BORDERS.split(text) if word]
    return [word for word in words if not core or word not in FILLING]


def _matches(name: str, read: dict[str, Named]) -> list[str]:
    """Return the columns whose names have the words of a column of the contract, but for filling ones."""
    role, words = wanted(name)
    of_role = {column: named.words for column, named in read.items() if named.role == role}
    if same := [column for column, others in of_role.items() if others == words]:
        return same
    if name in OTHER_WORDS:
        cores = [{name}, *({other} for other in OTHER_WORDS.get(name, ()))]
        return [column for column, others in of_role.items() if others - COUNTS in cores]
    return [column for column, others in of_role.items() if others - FILLING == words - FILLING]


def with_units(stated: dict[str, MappingEntry]) -> dict[str, MappingEntry]:
    """Return stated columns with the units that their names write, where no unit is stated."""
    out = {}
    for name, entry in stated.items():
        unit, quantity = read_name(entry.column).unit, quantity_of(name)
        written = entry.unit is None and quantity is not None and unit in UNITS[quantity]
        out[name] = entry.model_copy(update={"unit": unit}) if written else entry
    return out
