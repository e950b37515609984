"""How long an effect lasts, and where it acts in each of several experiments.

A target names a device by its place in the ordinary set-up. `@K` after it means: from experiment K on, as
long as what belongs to it lasts (a session, a zero, a survey).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.targets import CELL_NAMES, Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import VARYING
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES
from tulip_testbed.measurements.manipulations import Arrangement, Experiment

Values = tuple[float, ...]

FROM = "@"


@dataclass(frozen=True)
class Lasting:
    """How long an effect stays the same, and what takes it along.

    Attributes:
        until: what ends it: "" nothing; "session" the end of a session; "tare" that or taring; "survey" that
            or a move of the plates or of the robot; "zero" the next zero of its joint's encoder; "cable" the
            removal of the cable.
        of_room: whether its values are a vector of the room, which a turned robot sees the other way round.
        moves: "plate" if it goes with its plate to another place; "plate and corners" if the values are
            corners of that plate. A cell always takes its fault along.
        on_axes: whether its values are along the plate's axes, which a turned plate turns.
        in_sequence: whether it depends on the order of the postures within one experiment.
    """

    until: str = ""
    of_room: bool = False
    moves: str = ""
    on_axes: bool = False
    in_sequence: bool = False

    def ended(self, target: str, state: Arrangement) -> bool:
        """Return whether the manipulations of an experiment made the instrument exact again."""
        if self.until == "zero":
            return target in state.zeroed
        return {"tare": state.tared, "survey": state.moved}.get(self.until, False)

    def phase(self, target: str, one: Experiment, number: int) -> tuple[object, ...]:
        """Return what is the same in two experiments (indices) in which the effect is the same."""
        state, session = one.arrangement, one.session or number
        return {
            "session": (session,),
            "tare": (session, state.tared),
            "survey": (session, state.moved, state.robot_turned),
            "zero": (target in state.zeroed,),
        }.get(self.until, ())


ALWAYS = Lasting()


class HasTargets(Protocol):
    """The part of an effect that decides where it acts."""

    @property
    def lasting(self) -> Lasting: ...

    @property
    def targets(self) -> Targets: ...


Change = Callable[[Observation, str, Values], Observation]


def split_target(target: str) -> tuple[str, int | None]:
    """Return a target and the number of the experiment from which on it is meant, None: all."""
    name, mark, number = target.rpartition(FROM)
    return (name, int(number)) if mark and number.isdecimal() else (target, None)


def everywhere(target: str) -> bool:
    """Return whether a target is meant in all experiments, also future ones."""
    return split_target(target)[1] is None


def targets_over(
    effect: HasTargets, targets: Sequence[str], experiments: tuple[Experiment, ...]
) -> tuple[str, ...]:
    """List the targets that an effect has in several experiments, each as long as it stays the same."""
    if not experiments:
        return tuple(targets)
    if effect.lasting.until == "cable" and not any(one.arrangement.cable for one in experiments):
        return ()
    out = []
    for target in targets:
        numbers = sorted(set(epochs(effect.lasting, target, experiments)))
        out += [f"{target}{FROM}{number}" for number in numbers] if len(numbers) > 1 else [target]
    return tuple(out)


@lru_cache(maxsize=4096)
def epochs(lasting: Lasting, target: str, experiments: tuple[Experiment, ...]) -> tuple[int, ...]:
    """Return by experiment the number, from 1, of the first in which a target (unmarked) was the same."""
    phases = [lasting.phase(target, one, k) for k, one in enumerate(experiments)]
    return tuple(1 + phases.index(phase) for phase in phases)


def acting(
    effect: HasTargets, target: str, values: Values, experiments: tuple[Experiment, ...], number: int
) -> tuple[str, Values] | None:
    """Return target and values with which an effect acts in experiment `number`, from 0, or None."""
    name, first = split_target(target)
    if first is not None and epochs(effect.lasting, name, experiments)[number] != first:
        return None
    return arranged(effect, name, values, experiments[number])


def arranged(effect: HasTargets, target: str, values: Values, one: Experiment) -> tuple[str, Values] | None:
    """Return target and values of an effect as it acts in a manipulated laboratory, None: it does not.

    A device takes its fault along to its new place; of the room, a turned robot sees the opposite.
    """
    state, lasting = one.arrangement, effect.lasting
    if lasting.until == "cable" and not state.cable:
        return None
    if lasting.of_room and state.robot_turned:
        return target, tuple(-value for value in values)
    of_cell = effect.targets is CELL_NAMES
    if not (of_cell or lasting.moves):
        return target, values
    first = CELLS.index(target if of_cell else f"{target}.{CORNERS[0]}")
    place = state.place_of[first]
    if lasting.moves == "plate and corners":
        values = tuple(float(state.place_of[first + round(value)] % len(CORNERS)) for value in values)
    if lasting.on_axes and (place - first) % len(CORNERS):
        values = tuple(-value for value in values)
    return CELLS[place] if of_cell else PLATES[place // len(CORNERS)], values


def by_experiment(
    effect: HasTargets, change: Change, observed: Observation, target: str, values: Values
) -> Observation:
    """Change every experiment's rows by an effect as it acts there, by its change of ordinary ones."""
    m = observed.measurements
    if not m.experiments:
        return change(observed, target, values)
    whole = not effect.lasting.in_sequence
    groups: dict[object, list[int]] = {}
    acts = [acting(effect, target, values, m.experiments, k) for k in range(len(m.experiments))]
    for k, act in enumerate(acts):
        groups.setdefault(act if whole else k, []).append(k)
    number, out = m.of_experiment, {}
    for group in groups.values():
        act, rows = acts[group[0]], np.flatnonzero(np.isin(number, group))
        if act is None or not len(rows):
            continue
        if len(groups) == 1:
            return change(observed, *act)
        changed = change(observed if whole else observed.take(rows), *act)
        for field in VARYING:
            after = getattr(changed, field)
            if whole and after is getattr(observed, field):
                continue
            values_of = out.setdefault(field, getattr(observed, field).copy())
            values_of[rows] = after[rows] if whole else after
    return observed.changed(**out) if out else observed


def check_everywhere(target: str, where: str) -> None:
    """Refuse a target of one session where a laboratory is simulated."""
    if not everywhere(target):
        raise InputError(f"{where}: found an effect of one session only, expected one of every experiment")
