"""The limits of a motion between two postures, and its margins to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.experiments.protocols.motion_loads import MotionLoads
from tulip_testbed.identification.feasibility import stability_margin, support_polygon
from tulip_testbed.identification.link_clearances import LinkPairs, clearances_at, link_pairs
from tulip_testbed.identification.link_paths import SHARE, PathBetween, path_clearances
from tulip_testbed.identification.planning.one_foot import with_feet_exchanged
from tulip_testbed.identification.planning_ranges import planning_margins, planning_ranges
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.robot import Robot, joint_ranges

TORQUE_SHARE = 0.95  # of a drive's limit, dry friction included; the rest is the servo's
ROUNDING = 1e-4  # m, rad, by which a planned posture may touch its own margins

RANGE, LINKS = "joint range", "distance of links"
GEOMETRIC = (RANGE, LINKS)
TORQUE, SUPPORT = "torque", "margin of the CoM and the zero-moment point"
SOLE, LIFTED = "load inside each sole", "height of the foot in the air"


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of a robot's motions.

    Attributes:
        ranges: of the joints, (n, 2) [rad].
        torques: largest torques of the drives, (n,) [N m].
        stability_margin: of the centre of mass and the zero-moment point inside the support polygon [m].
        sole_margin: of the load's point inside each sole [m].
        lifted: least height of a foot in the air [m].
        pairs: links that must keep a distance, in the frame of the right and of the left foot.
    """

    ranges: np.ndarray
    torques: np.ndarray
    stability_margin: float
    sole_margin: float
    lifted: float
    pairs: tuple[LinkPairs, LinkPairs]


def motion_limits(robot: Robot) -> MotionLimits:
    """Return the limits of a robot: of margins that its plans keep at rest beyond stability, half."""
    margins = planning_margins(robot)
    ranges = planning_ranges(robot) if "planning" in robot.settings else None
    feet = (robot, with_feet_exchanged(robot))
    return MotionLimits(
        ranges=joint_ranges(robot.model),
        torques=torque_limits(robot),
        stability_margin=0.0 if ranges is None else ranges.stability_margin,
        sole_margin=0.0 if ranges is None else SHARE * ranges.sole_margin,
        lifted=SHARE * margins.lifted,
        pairs=(link_pairs(feet[0], margins.link_clearance), link_pairs(feet[1], margins.link_clearance)),
    )


def geometric_room(
    limits: MotionLimits,
    path_between: PathBetween,
    start: np.ndarray,
    end: np.ndarray,
    angles: np.ndarray,
    base: int,
) -> dict[str, float]:
    """Return how much room the joints' ranges and the links' distances leave [rad, m]; negative: too little.

    Links that are nearer at an end of the motion than what they should keep need not be farther on the way.

    Args:
        start, end: joint angles of both postures, (n,) [rad]. angles: on the way, (k, n) [rad].
        base: foot that carries the base frame, 0: right.
    """
    pairs = limits.pairs[base]
    inside = np.minimum(angles - limits.ranges[:, 0], limits.ranges[:, 1] - angles).min()
    within = SHARE * float(pairs.needed.max(initial=0.0))
    ends = clearances_at(pairs, np.array([start, end]), within).distance.min(axis=0)
    needed = np.minimum(SHARE * pairs.needed, ends)
    distance = path_clearances(pairs, path_between, start, end, within).distance
    return {
        RANGE: float(inside) + ROUNDING,
        LINKS: float((distance - needed).min(initial=within)) + ROUNDING,
    }


def dynamic_room(limits: MotionLimits, loads: MotionLoads, support: str) -> dict[str, float]:
    """Return how much room torques [-], stability and soles [m] leave; negative: too little.

    Args:
        support: "double", "right" or "left".
    """
    stands = feet_in_contact(np.array([support]))[0]
    soles = loads.soles[0, stands, :, :2]
    used = ((np.abs(loads.torques) + np.abs(loads.friction)) / limits.torques).max()
    polygon = support_polygon(soles)
    inside = stability_margin(np.concatenate([loads.com, loads.zmp]), polygon)  # of the nearest
    room = {
        TORQUE: TORQUE_SHARE - float(used),
        SUPPORT: inside - limits.stability_margin + ROUNDING,
    }
    if stands.all():
        on_soles = [
            stability_margin(loads.foot_points[:, side], support_polygon(sole))
            for side, sole in enumerate(soles)
        ]
        room[SOLE] = min(on_soles) - limits.sole_margin + ROUNDING
    else:
        room[LIFTED] = float(loads.soles[:, ~stands, :, 2].min()) - limits.lifted
    return room
