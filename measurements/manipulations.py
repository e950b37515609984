"""Differences of an experiment's laboratory from its ordinary set-up: turned plates, a known mass, ...

Manipulations are texts of a small grammar in the order in which they were carried out. They describe the
state of the laboratory, not a change since the experiment before.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
TURNED = re.compile(r"(right|left) plate turned by 180 deg")
MASS = re.compile(rf"known mass ({NUMBER}) kg at (\w+) \(({NUMBER}), ?({NUMBER}), ?({NUMBER})\)")
ZEROED = re.compile(r"encoder re-zeroed: (\w+)")
EXCHANGED, MOVED, TARED = "plates exchanged", "plates moved", "cells re-tared"
UNTIED, ROBOT_TURNED = "cable removed", "robot turned by 180 deg"
FORMS = (
    *(EXCHANGED, "PLATE plate turned by 180 deg", MOVED, TARED, UNTIED, ROBOT_TURNED),
    *("encoder re-zeroed: JOINT", "known mass KILOGRAMS kg at LINK (X, Y, Z)"),
)
OF_CELLS = (EXCHANGED, TARED, ROBOT_TURNED)  # and turned plates: they need plates on cells
MOST_MASS, MOST_PLACE = 1e3, 10.0  # kg, m


@dataclass(frozen=True)
class KnownMass:
    """A mass that is fixed to a link: mass [kg], link, place in the link's frame [m]."""

    mass: float
    link: str
    place: tuple[float, float, float]


@dataclass(frozen=True)
class Arrangement:
    """The state of a laboratory after its manipulations.

    Attributes:
        place_of: for each cell of the ordinary set-up, in the order of `CELLS`, the number of the place at
            which it stands now, seen from the robot.
        robot_turned: whether the robot faces the other way, so that the room is turned as it sees it.
        cable: whether a cable or hoist may pull at the torso.
        moved: whether the plates' places were surveyed again. tared: whether the cells were tared again.
        zeroed: joints whose encoders were zeroed again.
        masses: known masses on the robot.
    """

    place_of: tuple[int, ...] = tuple(range(len(CELLS)))
    robot_turned: bool = False
    cable: bool = True
    moved: bool = False
    tared: bool = False
    zeroed: frozenset[str] = frozenset()
    masses: tuple[KnownMass, ...] = ()

    @property
    def known_mass(self) -> float:
        """Return the sum of the known masses [kg]."""
        return sum(one.mass for one in self.masses)


@dataclass(frozen=True)
class Experiment:
    """One of several experiments with a robot.

    Attributes:
        session: experiments of one session share tares, tilt of the floor and survey of the plates; "": it
            shares them with no other experiment.
        manipulations: texts of the grammar.
    """

    session: str = ""
    manipulations: tuple[str, ...] = ()

    @property
    def arrangement(self) -> Arrangement:
        return arrangement_of(self.manipulations)


def arrangement_of(manipulations: Sequence[str], where: str = "manipulations") -> Arrangement:
    return _read(tuple(manipulations), where)


@lru_cache(maxsize=256)
def _read(manipulations: tuple[str, ...], where: str) -> Arrangement:
    found, seen = Arrangement(), dict[str, str]()
    for text in manipulations:
        key, found = _carried_out(found, text, where)
        if key in seen:
            both = f"'{shortened(seen[key])}' and '{shortened(text)}'"
            raise InputError(
                f"{where}: found {both}, which contradict each other: expected each once, as the state of "
                "the laboratory and not as a change since the experiment before"
            )
        seen[key] = text
    return found


def _carried_out(before: Arrangement, text: str, where: str) -> tuple[str, Arrangement]:
    """Return what a manipulation acts on and the state after it."""
    if text == EXCHANGED:
        return text, replace(before, place_of=_then(before, _on_other_plate))
    if text == ROBOT_TURNED:
        places = _then(before, lambda cell: _opposite(_on_other_plate(cell)))
        return text, replace(before, place_of=places, robot_turned=True)
    if found := TURNED.fullmatch(text):
        plate = found[1]
        places = _then(before, lambda cell: _opposite(cell) if cell.startswith(plate) else cell)
        return f"{plate} plate", replace(before, place_of=places)
    simple: dict[str, dict[str, Any]] = {
        MOVED: {"moved": True},
        TARED: {"tared": True},
        UNTIED: {"cable": False},
    }
    if text in simple:
        return text, replace(before, **simple[text])
    if found := ZEROED.fullmatch(text):
        return text, replace(before, zeroed=before.zeroed | {found[1]})
    if found := MASS.fullmatch(text):
        x, y, z = (float(found[k]) for k in (3, 4, 5))
        one = KnownMass(float(found[1]), found[2], (x, y, z))
        if not 0 < one.mass <= MOST_MASS or math.hypot(x, y, z) > MOST_PLACE:
            raise InputError(
                f"{where}: found '{shortened(text)}', expected more than 0 and at most {MOST_MASS:g} kg, "
                f"within {MOST_PLACE:g} m"
            )
        return f"{one.link}, {one.place}", replace(before, masses=(*before.masses, one))
    raise InputError(f"{where}: found '{shortened(text)}', expected one of {listed(map(repr, FORMS))}")


def _then(before: Arrangement, move: Callable[[str], str]) -> tuple[int, ...]:
    return tuple(CELLS.index(move(CELLS[place])) for place in before.place_of)


def _on_other_plate(cell: str) -> str:
    plate, corner = cell.split(".")
    return f"{PLATES[1 - PLATES.index(plate)]}.{corner}"


def _opposite(cell: str) -> str:
    plate, corner = cell.split(".")
    return f"{plate}.{CORNERS[(CORNERS.index(corner) + 2) % len(CORNERS)]}"


def written_mass(one: KnownMass) -> str:
    return f"known mass {one.mass:g} kg at {one.link} ({', '.join(f'{x:g}' for x in one.place)})"


def needs_cells(text: str) -> bool:
    return text in OF_CELLS or TURNED.fullmatch(text) is not None
