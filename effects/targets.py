"""Targets of effects: a joint, cell, plate, link, corner of a foot, placement, or the whole."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tulip_testbed.base.errors import InputError, listed, look_up, shortened
from tulip_testbed.identification.kinematics import tree_of
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.sim.robot import Robot, between_feet, joint_names

LEAST_LENGTH = 1e-4  # m
PARALLEL = 0.1  # rad between lengths, below which nothing tells them apart
PLACEMENT_NUMBER = re.compile(r"0|-?[1-9][0-9]{0,15}")


@dataclass(frozen=True)
class Targets:
    """A kind of target.

    Attributes:
        word: in usage texts; "" where the effect acts on the whole.
        of: (robot, placements) -> names of all targets, written as in a measurement folder.
    """

    word: str
    of: Callable[[Robot, tuple[int, ...]], tuple[str, ...]]


def links(robot: Robot) -> tuple[str, ...]:
    """Return the names of the robot's bodies that have a mass, in MJCF order."""
    model = robot.model
    return tuple(model.body(k).name for k in range(1, model.nbody) if model.body_mass[k] > 0)


Ways = tuple[tuple[int, np.ndarray], ...]


@lru_cache(maxsize=8)
def lengthenings(robot: Robot) -> dict[str, Ways]:
    """Return how the joints of the links between the feet move if their link becomes longer, by link.

    Only joints of the chain from foot to foot count: an arm does not carry a foot. A link of a leg keeps its
    own joint and moves the next one. The link that bears both legs moves both by half, away from each other;
    it is left out where a leg goes on along the axis of its hip: nothing then tells these lengths apart.

    Returns:
        By link: numbers of edges, and where their joints move in the link's frame per length, (3,).
    """
    tree = tree_of(robot.model)
    in_chain = between_feet(robot.model, robot)
    chain = [(k, edge) for k, edge in enumerate(tree.edges) if edge.joint >= 0 and in_chain[edge.joint]]
    out: dict[int, Ways] = {}
    for frame in tree.frame_of_link:
        after = [(k, edge.anchor[0]) for k, edge in chain if edge.parent == frame]
        own = [edge.anchor[1] for _, edge in chain if edge.child == frame]
        if len(after) + len(own) == 2:
            way = after[0][1] - (*own, after[-1][1])[0]
            length = float(np.linalg.norm(way)) * len(after)
            if length > LEAST_LENGTH:
                out[frame] = tuple((k, way * s / length) for (k, _), s in zip(after, (1, -1), strict=False))

    def goes_on(k: int, way: np.ndarray) -> bool:
        edge = tree.edges[k]
        assert edge.axis is not None
        lines = [edge.placement.T @ way, *(on for _, on in out.get(edge.child, ()))]
        aside = [np.linalg.norm(np.cross(edge.axis, line)) / np.linalg.norm(line) for line in lines]
        return len(lines) > 1 and bool(max(aside) < PARALLEL)

    return {
        link: out[frame]
        for link, frame in zip(tree.links, tree.frame_of_link, strict=True)
        if frame in out and not (len(out[frame]) == 2 and any(goes_on(*way) for way in out[frame]))
    }


def plate_of(robot: Robot, joint: str) -> str:
    """Return the plate under the foot of a joint's leg, "" if not exactly one foot is beyond the joint."""
    model = robot.model
    moved = int(model.joint(joint).bodyid[0])
    beyond = []
    for plate, foot in zip(PLATES, robot.feet, strict=True):
        body = model.body(foot).id
        while body not in (0, moved):
            body = int(model.body_parentid[body])
        beyond += [plate] if body == moved else []
    return beyond[0] if len(beyond) == 1 else ""


@lru_cache(maxsize=8)
def leg_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints between the torso and one foot, in the order of the joints."""
    return tuple(name for name in joint_names(robot.model) if plate_of(robot, name))


WHOLE = Targets("", lambda robot, placements: ("",))
JOINTS = Targets("JOINT", lambda robot, placements: joint_names(robot.model))
LEG_JOINTS = Targets("JOINT", lambda robot, placements: leg_joints(robot))
PLATE_NAMES = Targets("PLATE", lambda robot, placements: PLATES)
CELL_NAMES = Targets("PLATE.CORNER", lambda robot, placements: CELLS)
FEET = Targets("FOOT", lambda robot, placements: PLATES)
WRENCH_CHANNELS = Targets(
    "FOOT.CHANNEL", lambda robot, placements: tuple(f"{foot}.{one}" for foot in PLATES for one in WRENCH)
)
# Nothing is computed from mz, so what it reads of other channels does not matter.
WRENCH_PAIRS = Targets(
    "FOOT.CHANNEL.LOAD",
    lambda robot, placements: tuple(
        f"{foot}.{one}.{load}" for foot in PLATES for one in WRENCH[:-1] for load in WRENCH
    ),
)
LINKS = Targets("LINK", lambda robot, placements: links(robot))
LEG_LINKS = Targets("LINK", lambda robot, placements: tuple(lengthenings(robot)))
FOOT_CORNERS = Targets(
    "FOOT.CORNER",
    lambda robot, placements: tuple(f"{foot}.{corner}" for foot in robot.feet for corner in CORNERS),
)
PLACEMENTS = Targets("PLACEMENT", lambda robot, placements: tuple(str(number) for number in placements))


def check_target(
    targets: Targets, target: str, robot: Robot, placements: Sequence[int] | None, where: str
) -> None:
    """Refuse a target that does not exist; without placements any number of one is accepted."""
    if not targets.word:
        if target:
            raise InputError(f"{where}: found target '{shortened(target)}', expected none")
        return
    known = targets is not PLACEMENTS or placements is not None
    valid = targets.of(robot, tuple(int(number) for number in placements or ()))
    if not target:
        one_of = f", one of {listed(valid)}" if known else ""
        raise InputError(f"{where}: found no target, expected {targets.word}{one_of}")
    if known and not valid:
        raise InputError(f"{where}: found target '{shortened(target)}', which this robot does not have")
    if known:
        look_up("target", target, valid, where)
    elif not PLACEMENT_NUMBER.fullmatch(target):
        raise InputError(f"{where}: found target '{shortened(target)}', expected a placement's number")
