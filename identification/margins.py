"""Margins that planned postures keep beyond the planning ranges, in proportion to the robot's size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.planning_ranges import MARGIN_KEYS, numbers_of
from tulip_testbed.sim.robot import Robot, bodies_to_root, sole_corners

# Shares of the weight, of weight times foot length, and of the leg's length.
FOOT_LOAD = 0.1108
FOOT_MOMENT = 0.01219
CLEARANCE, LIFTED = 0.0155, 0.031
DIGITS = 3  # to which these margins are rounded


@dataclass(frozen=True)
class Margins:
    """Margins in addition to the planning ranges.

    Attributes:
        foot_load: smallest load of each foot [N].
        foot_moment: s.d. of each foot's tilting moment about its prediction, by dry friction and tracking
            errors in a stiff closed chain; soles keep it with the same assurance [N m]. TULip's drives (0.8
            of their dry friction, command errors of 0.5 mrad) give 0.5 about x and 0.6 about y.
        leg_clearance: distance between the capsules around the limbs of the two legs [m].
        link_clearance: distance between the shapes of links that are not neighbours, and between links other
            than the feet and the ground [m].
        lifted: height of the swing sole's lowest corner over the plates in single support [m].
        board: distance between a sole and the edge of its board, since boards are laid with errors of some
            millimetres and a corner beyond the edge carries no load [m].
        mass_sd: s.d. of every link's mass relative to the nominal one, and of its centre of mass relative to
            the half edges of its inertia box, all independent [-].
        assurance: number of standard deviations of the centre of mass that every edge of the support
            polygon keeps in addition to d_s; 1.645 means 95 % probability for each edge [-].
        torque_share: largest predicted holding torque relative to the drive's limit [-].
        joint: distance from both ends of a joint's range, since a joint at its stop takes load from the feet
            [rad].
        stretch: shortening of the distance from hip to ankle relative to a straight leg; straight knees are
            singular, and paths between such postures may be out of reach [-].
        rounding: distance from every bound in the constraint's own scale, so that rounding by solver and
            file format violates none [-].
    """

    foot_load: float
    foot_moment: float
    leg_clearance: float
    link_clearance: float
    lifted: float
    board: float = 0.01
    mass_sd: float = 0.10
    assurance: float = 1.645
    torque_share: float = 0.85
    joint: float = 0.002
    stretch: float = 0.01
    rounding: float = 1e-5


def planning_margins(robot: Robot) -> Margins:
    """Return the margins of the [planning] table of the robot's description, or else those of its size.

    Raises:
        InputError: a margin is no number of at least 0.
    """
    model, leg = robot.model, leg_length(robot)
    weight = float(model.body_subtreemass[0] * -model.opt.gravity[2])
    foot = float(np.ptp(sole_corners(model, robot.stance_foot)[:, 0]))
    sized = {
        "foot_load": FOOT_LOAD * weight,
        "foot_moment": FOOT_MOMENT * weight * foot,
        "leg_clearance": CLEARANCE * leg,
        "link_clearance": CLEARANCE * leg,
        "lifted": LIFTED * leg,
    }
    table = robot.settings.get("planning", {})
    where = f"{robot.path}: [planning]: key"
    stated = {key: _stated(f"{where} '{key}'", table[key]) for key in MARGIN_KEYS if key in table}
    return Margins(**{name: _rounded(value) for name, value in sized.items()} | stated)


def leg_length(robot: Robot) -> float:
    """Return the length from the hip over the joints to the ankle of the stance leg at its longest [m].

    It is the sum of the distances between the origins of the bodies from the first one that this leg does
    not share with the other to the foot.
    """
    model = robot.model
    stance, swing = (list(bodies_to_root(model, model.body(foot).id)) for foot in robot.feet)
    own = [body for body in stance if body not in swing]
    return float(np.linalg.norm(model.body_pos[own[:-1]], axis=1).sum())


def _stated(where: str, value: Any) -> float:
    number = numbers_of(where, value, is_range=False)
    if number < 0:
        raise InputError(f"{where}: found {number:g}, expected a number of at least 0")
    return number


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
