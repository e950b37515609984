"""What an effect may concern: a joint, a cell, a plate, a link, a foot's corner, a placement, all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.kinematics import Tree, moved_frames, tree_of
from tulip_testbed.sim.errors import InputError, listed, look_up
from tulip_testbed.sim.robot import CELLS, CORNERS, PLATES, Robot, joint_names

LEAST_LENGTH = 1e-4  # m


@dataclass(frozen=True)
class Targets:
    """A kind of target.

    Attributes:
        word: for help texts; "" where the effect is of the whole.
        of: all of them, of a robot and an experiment's placements, written as in the measurement folder.
    """

    word: str
    of: Callable[[Robot, tuple[int, ...]], tuple[str, ...]]


def links(robot: Robot) -> tuple[str, ...]:
    """Bodies of the robot in MJCF order."""
    model = robot.model
    return tuple(model.body(k).name for k in range(1, model.nbody))


def leg_links(robot: Robot) -> tuple[str, ...]:
    """Links between the feet whose joint is followed by exactly one other, at a distance."""
    tree = tree_of(robot.model)
    moved = moved_frames(tree, tree.frame(robot.stance_foot))[:, tree.frame(robot.swing_foot)]
    return tuple(
        link
        for link, frame in zip(tree.links, tree.frame_of_link, strict=True)
        if any(edge.child == frame and edge.joint >= 0 and moved[edge.joint] for edge in tree.edges)
        and len(after := [edge for edge in tree.edges if edge.parent == frame]) == 1
        and after[0].joint >= 0
        and moved[after[0].joint]
        and np.linalg.norm(next_joint(tree, link)[1]) > LEAST_LENGTH
    )


def next_joint(tree: Tree, link: str) -> tuple[int, np.ndarray]:
    """Number of the edge to the joint after a link's own, and the way there in the link's frame, (3,) [m]."""
    frame = tree.frame(link)
    number, edge = next((k, edge) for k, edge in enumerate(tree.edges) if edge.parent == frame)
    own = next(edge for edge in tree.edges if edge.child == frame)
    return number, edge.anchor[0] - own.anchor[1]


WHOLE = Targets("", lambda robot, placements: ("",))
JOINTS = Targets("JOINT", lambda robot, placements: joint_names(robot.model))
PLATE_NAMES = Targets("PLATE", lambda robot, placements: PLATES)
CELL_NAMES = Targets("PLATE.CORNER", lambda robot, placements: CELLS)
LINKS = Targets("LINK", lambda robot, placements: links(robot))
LEG_LINKS = Targets("LINK", lambda robot, placements: leg_links(robot))
FOOT_CORNERS = Targets(
    "FOOT.CORNER",
    lambda robot, placements: tuple(f"{foot}.{corner}" for foot in robot.feet for corner in CORNERS),
)
PLACEMENTS = Targets("PLACEMENT", lambda robot, placements: tuple(str(number) for number in placements))


def check_target(targets: Targets, target: str, valid: tuple[str, ...], where: str) -> None:
    """Refuse a target that does not exist.

    Raises:
        InputError: names what was found and what is valid.
    """
    if not targets.word and target:
        raise InputError(f"{where}: found target '{target}', expected none")
    if targets.word and not target:
        raise InputError(f"{where}: found no target, expected {targets.word}, one of {listed(valid)}")
    if targets.word:
        look_up("target", target, valid, where)
