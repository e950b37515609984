"""Targets of held-out faults, chosen by a number, and the form of their right descriptions."""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.targets import links
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.robot import Robot, joint_names

Answers = frozenset[tuple[str, str]]  # what errs, and as a function of what

TURN = 2.4  # rad a number, so that numbers point in all directions


def pairs(what: str, *of: str) -> Answers:
    """Return the descriptions of one thing that errs, as a function of each of these."""
    return frozenset((what, one) for one in of)


def joint_at(robot: Robot, number: int) -> str:
    """Return a joint."""
    names = joint_names(robot.model)
    return names[number % len(names)]


def plate_at(number: int) -> str:
    """Return a plate."""
    return PLATES[number % len(PLATES)]


def foot_at(robot: Robot, number: int) -> str:
    """Return a foot."""
    return robot.feet[number % 2]


def link_between(robot: Robot, number: int) -> str:
    """Return a link between the torso and the feet."""
    inner = [link for link in links(robot)[1:] if link not in robot.feet]
    return inner[number % len(inner)]


def heading(number: int) -> np.ndarray:
    """Return a horizontal unit vector, (2,)."""
    return np.array([np.cos(TURN * number), np.sin(TURN * number)])


def add_rope(
    spec: mujoco.MjSpec,
    name: str,
    tied: tuple[str, np.ndarray],
    anchor: np.ndarray,
    stiffness: float,
    length: tuple[float, float],
) -> None:
    """Tie a point of a body to a far one by a spring.

    Args:
        tied: the body, and the point in its frame, (3,) [m].
        anchor: in the base frame, (3,) [m].
        stiffness: of the spring [N/m].
        length: range of lengths without force [m].
    """
    spec.worldbody.add_site(name=f"{name}_anchor", pos=anchor)
    spec.body(tied[0]).add_site(name=f"{name}_hook", pos=tied[1])
    rope = spec.add_tendon(name=name, stiffness=[stiffness, 0.0, 0.0], springlength=list(length))
    rope.wrap_site(f"{name}_anchor")
    rope.wrap_site(f"{name}_hook")
