"""Where an effect acts in each of several experiments: with the device, the session or the robot.

A target names a device by its place in the ordinary set-up. `@K` after it means: from experiment K on, as
long as what belongs to it lasts (a session, a zero, a survey).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.targets import CELL_NAMES, Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import VARYING
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES
from tulip_testbed.measurements.manipulations import Experiment

Values = tuple[float, ...]
FROM = "@"
OF_SESSION = ("tilt", "cell-tare", "wrench-zero", "plate-translation", "plate-yaw")
OF_SURVEY = ("plate-translation", "plate-yaw")  # anew where the plates were moved or the robot turned
OF_CABLE = ("tether", "tether-spring")
TURNING = ("tilt", "tether")  # vectors of the room: a robot that is turned sees them the other way round
OF_PLATE = ("plate-drift", "swapped-cells")  # of a plate rather than of its place
IN_SEQUENCE = ("creep",)  # by the order of the postures within one experiment


class Kind(Protocol):
    """The part of an effect that decides where it acts."""

    @property
    def name(self) -> str: ...

    @property
    def targets(self) -> Targets: ...


class Change(Protocol):
    """Remove an effect from an observation, or change it by what its readings do not show."""

    def __call__(self, observed: Observation, target: str, values: Values, /) -> Observation: ...


def split_target(target: str) -> tuple[str, int | None]:
    """Return a target and the number of the experiment from which on it is meant, None: all."""
    name, mark, number = target.partition(FROM)
    return name, int(number) if mark and number.isdigit() else None


def everywhere(target: str) -> bool:
    """Return whether a target is meant in all experiments, also future ones."""
    return split_target(target)[1] is None


def targets_over(
    effect: Kind, targets: Sequence[str], experiments: tuple[Experiment, ...]
) -> tuple[str, ...]:
    """List the targets that an effect has in several experiments, each as long as it stays the same."""
    if not experiments:
        return tuple(targets)
    if effect.name in OF_CABLE and not any(one.arrangement.cable for one in experiments):
        return ()
    out = []
    for target in targets:
        found = epochs(effect.name, target, experiments)
        several = len(set(found)) > 1
        out += [f"{target}{FROM}{number}" for number in sorted(set(found))] if several else [target]
    return tuple(out)


@lru_cache(maxsize=4096)
def epochs(name: str, target: str, experiments: tuple[Experiment, ...]) -> tuple[int, ...]:
    """Return for each experiment the number, from 1, of the first in which an effect was the same.

    Args:
        name, target: of the effect, without the mark of an experiment.
    """
    keys = [_lasting(name, target, one, k) for k, one in enumerate(experiments)]
    return tuple(1 + keys.index(key) for key in keys)


def _lasting(name: str, target: str, one: Experiment, number: int) -> tuple[object, ...]:
    """Return what is the same in two experiments in which an effect is the same."""
    state = one.arrangement
    if name == "encoder-offset":
        return (target in state.zeroed,)
    if name not in OF_SESSION:
        return ()
    session = one.session or number
    if name in OF_SURVEY:
        return session, state.moved, state.robot_turned
    return (session, state.tared) if name == "cell-tare" else (session,)


def acting(
    effect: Kind, target: str, values: Values, experiments: tuple[Experiment, ...], number: int
) -> tuple[str, Values] | None:
    """Return target and values with which an effect acts in one of the experiments, None: it does not.

    Args:
        number: index of the experiment.
    """
    name, first = split_target(target)
    if first is not None and epochs(effect.name, name, experiments)[number] != first:
        return None
    return arranged(effect, name, values, experiments[number])


def arranged(effect: Kind, target: str, values: Values, one: Experiment) -> tuple[str, Values] | None:
    """Return target and values of an effect as it acts in a manipulated laboratory, None: it does not.

    A device takes its fault along to its new place; of the room, a turned robot sees the opposite.
    """
    state = one.arrangement
    if effect.name in OF_CABLE and not state.cable:
        return None
    if effect.name in TURNING and state.robot_turned:
        return target, tuple(-value for value in values)
    if effect.targets is CELL_NAMES:
        return CELLS[state.place_of[CELLS.index(target)]], values
    if effect.name in OF_PLATE:
        places = [state.place_of[k] for k in range(len(CELLS)) if CELLS[k].startswith(target)]
        plate = PLATES[places[0] // len(CORNERS)]
        if effect.name == "swapped-cells":
            pair = [float(places[round(value)] % len(CORNERS)) for value in values]
            return plate, tuple(pair)
        return plate, values
    return target, values


def by_experiment(
    effect: Kind, change: Change, observed: Observation, target: str, values: Values
) -> Observation:
    """Change the rows of every experiment by an effect as it acts there.

    Args:
        change: of the effect, in an ordinary laboratory.
    """
    m = observed.measurements
    if not m.experiments:
        return change(observed, target, values)
    acts = [acting(effect, target, values, m.experiments, k) for k in range(len(m.experiments))]
    if None not in acts and len(set(acts)) == 1 and (len(acts) == 1 or effect.name not in IN_SEQUENCE):
        assert acts[0] is not None
        return change(observed, *acts[0])
    number, out = m.of_experiment, {}
    groups = [[k] for k in range(len(acts))] if effect.name in IN_SEQUENCE else _alike(acts)
    for group in groups:
        act, rows = acts[group[0]], np.flatnonzero(np.isin(number, group))
        if act is None or not len(rows):
            continue
        whole = effect.name not in IN_SEQUENCE
        changed = change(observed if whole else observed.take(rows), *act)
        for field in VARYING:
            after = getattr(changed, field)
            if whole and after is getattr(observed, field):
                continue
            values_of = out.setdefault(field, getattr(observed, field).copy())
            values_of[rows] = after[rows] if whole else after
    return observed.changed(**out) if out else observed


def _alike(acts: Sequence[tuple[str, Values] | None]) -> list[list[int]]:
    groups: dict[tuple[str, Values] | None, list[int]] = {}
    for k, act in enumerate(acts):
        groups.setdefault(act, []).append(k)
    return list(groups.values())


def check_everywhere(target: str, where: str) -> None:
    """Refuse a target of one session where a laboratory is simulated.

    Raises:
        InputError: names it.
    """
    if not everywhere(target):
        raise InputError(f"{where}: found an effect of one session only, expected one of every experiment")
