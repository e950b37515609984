"""The right descriptions of the outside faults, and the descriptions that were given."""

from __future__ import annotations

from collections.abc import Callable

from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.law_candidates import is_law
from tulip_testbed.effects.laws.grammar import CATALOGUED, Sentence, joints_of_leg
from tulip_testbed.effects.targets import plate_of
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.robot import Robot, joint_names

Answers = tuple[tuple[str, str], ...]  # acceptable (what, of); "*" for of: any


def _joint(robot: Robot, number: int) -> str:
    names = joint_names(robot.model)
    return names[number % len(names)]


def _encoder(*of: str) -> Callable[[Robot, int], Answers]:
    return lambda robot, number: tuple((f"encoder:{_joint(robot, number)}", one) for one in of)


def _cell(of: str) -> Callable[[Robot, int], Answers]:
    return lambda robot, number: ((f"cell:{CELLS[number % len(CELLS)]}", of),)


def _of_leg(robot: Robot, number: int, *of: str) -> Answers:
    """Any encoder of the joint's leg, or all of them."""
    leg = plate_of(robot, _joint(robot, number))
    whats = [f"encoder:{name}" for name in joints_of_leg(robot, leg)] + [f"encoders:{leg}"]
    return tuple((what, one) for what in whats for one in of)


def _skewed(robot: Robot, number: int) -> Answers:
    name = _joint(robot, number)
    return (*_of_leg(robot, number, f"angle:{name}"), (f"encoder:{name}", "own-angle"))


def _sideways(robot: Robot, number: int) -> Answers:
    torques = [f"torque:{name}" for name in joint_names(robot.model)]
    return _of_leg(robot, number, "own-torque", "leg-load", *torques)


# What errs and as a function of what, by the name of the fault: everything that is right.
ANSWERS: dict[str, Callable[[Robot, int], Answers]] = {
    "encoder-eccentric": _encoder("own-angle"),
    "encoder-jump": _encoder("own-angle"),
    "encoder-teeth": _encoder("own-angle"),
    "encoder-coupled": lambda robot, number: (
        (f"encoder:{_joint(robot, number)}", f"angle:{_joint(robot, number - 1)}"),
    ),
    "cell-warm": _cell("time"),
    "cell-walk": _cell("time"),
    "cell-creep": _cell("time-since-loading"),
    "plate-bent": lambda robot, number: ((f"cells:{PLATES[number % 2]}", "plate-load"),),
    "boards-touch": lambda robot, number: tuple((f"cells:{plate}", "plate-load") for plate in PLATES),
    "axis-skewed": _skewed,
    "joint-sideways": _sideways,
    "cable-slack": lambda robot, number: (("force:torso", "*"),),
}


def said_by(candidate: Candidate) -> list[tuple[str, str]]:
    """Return (what, of) of a law, or of an effect of the catalogue that says what a law could; else none."""
    if is_law(candidate):
        sentence = Sentence(*candidate.target.split("/"))
        return [(sentence.what, sentence.of)]
    as_law = {name: (kind, of) for (kind, of, _), name in CATALOGUED.items()}
    if candidate.effect.name not in as_law:
        return []
    kind, of = as_law[candidate.effect.name]
    return [(f"{kind}:{candidate.target}", of)]


def is_right(found: tuple[str, str], answers: Answers) -> bool:
    """Return whether (what, of) is among the right answers."""
    return any(what == found[0] and of in ("*", found[1]) for what, of in answers)
