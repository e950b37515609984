"""The [planning] table of a robot's description: from where postures are drawn, and which margins they keep.

Margins that the table does not state are in proportion to the robot's size.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, choices, look_up, shortened
from tulip_testbed.sim.robot import (
    Robot,
    between_feet,
    bodies_to_root,
    joint_names,
    joint_ranges,
    sole_corners,
)

MOST_NUMBER = 1e6  # m, rad, deg, N: bound of any robot's ranges
# Keys of the same table that `planning_margins` reads.
MARGIN_KEYS = ("foot_load", "foot_moment", "board", "link_clearance", "lifted")

Range = tuple[float, float]
# Shares of the weight, of weight times foot length, and of the leg's length.
FOOT_LOAD = 0.1108
FOOT_MOMENT = 0.01219
CLEARANCE, LIFTED = 0.0155, 0.031
DIGITS = 3  # to which these margins are rounded


@dataclass(frozen=True)
class PlanningRanges:
    """Ranges from which postures are drawn, and the margins that they keep [m, rad, N].

    Attributes:
        swing_x, swing_y, swing_yaw: pose of the swing foot in the base frame.
        torso_roll, torso_pitch, torso_yaw: orientation of the torso.
        least_height: smallest height of the torso's origin (hip) over the soles.
        stability_margin: distance d_s of the centre of mass inside the support polygon.
        foot_clearance: distance d_f between the feet.
        sole_margin: distance of each foot's predicted centre of pressure inside its sole.
        least_cell_load: smallest load of any cell, its share of the board included.
        plate_gap: gap between the boards.
        joints: ranges of joints that are not between the feet, by name; the model's own range if not named.
    """

    swing_x: Range
    swing_y: Range
    swing_yaw: Range
    torso_roll: Range
    torso_pitch: Range
    torso_yaw: Range
    least_height: float
    stability_margin: float
    foot_clearance: float
    sole_margin: float
    least_cell_load: float
    plate_gap: float = 0.01
    joints: dict[str, Range] = dataclasses.field(default_factory=dict)

    @property
    def swing(self) -> np.ndarray:
        """Return the ranges of the swing foot's x, y and yaw, (3, 2) [m, m, rad]."""
        return np.array([self.swing_x, self.swing_y, self.swing_yaw])

    @property
    def torso(self) -> np.ndarray:
        """Return the ranges of the torso's roll, pitch and yaw, (3, 2) [rad]."""
        return np.array([self.torso_roll, self.torso_pitch, self.torso_yaw])


def planning_ranges(robot: Robot) -> PlanningRanges:
    """Read the [planning] table of the robot's description."""
    where, table = f"{robot.path}: [planning]", robot.settings.get("planning", {})
    fields = {f.name: f for f in dataclasses.fields(PlanningRanges) if f.name != "joints"}
    values: dict[str, Any] = {}
    for key, value in table.items():
        name = key.removesuffix("_deg")
        if name == "joints" and key != name:
            values[name] = _joint_table(where, value)
            continue
        if key in MARGIN_KEYS:
            continue
        if name not in fields:
            known = [*fields, "joints_deg", *MARGIN_KEYS]
            raise InputError(f"{where}: unknown key '{key}'; {choices(key, known)}")
        if name in values:
            raise InputError(f"{where}: found '{name}' and '{name}_deg', expected one of them")
        numbers = numbers_of(f"{where}: key '{key}'", value, is_range=fields[name].type == Range)
        in_rad = numbers if key == name else np.deg2rad(numbers).tolist()
        values[name] = tuple(in_rad) if isinstance(in_rad, list) else in_rad
    for name, f in fields.items():
        if name not in values and f.default is dataclasses.MISSING:
            raise InputError(f"{where}: key '{name}' is missing; add it to the table")
    return PlanningRanges(**values)


def _joint_table(where: str, table: Any) -> dict[str, Range]:
    if not isinstance(table, dict):
        raise InputError(
            f"{where}: key 'joints_deg': found {table!r}, expected a table of JOINT = [low, high]"
        )
    ranges = {}
    for joint, value in table.items():
        low, high = numbers_of(f"{where}: key 'joints_deg.{joint}'", value, is_range=True)
        ranges[joint] = (float(np.deg2rad(low)), float(np.deg2rad(high)))
    return ranges


def numbers_of(where: str, value: Any, is_range: bool) -> Any:
    """Return the value as a float, or as a list of two in ascending order."""
    numbers = value if is_range and isinstance(value, list) else [value]
    plain = all(type(v) in (int, float) and abs(v) < MOST_NUMBER for v in numbers)  # neither bool nor NaN
    if not plain or len(numbers) != 1 + is_range or numbers[0] > numbers[-1]:
        expected = "[low, high] with low <= high" if is_range else "a number"
        raise InputError(f"{where}: found {shortened(repr(value))}, expected {expected}")
    return [float(v) for v in numbers] if is_range else float(value)


def free_joint_ranges(robot: Robot, model: mujoco.MjModel, ranges: PlanningRanges) -> dict[str, Range]:
    """Return the ranges of the joints that are not between the feet [rad]."""
    where = f"{robot.path}: [planning]: key 'joints_deg"
    free = ~between_feet(model, robot)
    limits = {name: tuple(r) for name, r in zip(joint_names(model), joint_ranges(model), strict=True)}
    drawn = {name: limits[name] for name, is_free in zip(limits, free, strict=True) if is_free}
    for name, (low, high) in ranges.joints.items():
        look_up("joint", name, drawn, f"{where}' (joints that are not between the feet)")
        if low < limits[name][0] - 1e-9 or high > limits[name][1] + 1e-9:
            raise InputError(
                f"{where}.{name}': found {np.rad2deg([low, high]).tolist()}, expected within the model's "
                f"range {np.round(np.rad2deg(limits[name]), 3).tolist()}"
            )
        drawn[name] = (low, high)
    if endless := [name for name, interval in drawn.items() if not np.isfinite(interval).all()]:
        raise InputError(f"{where}': found no range for joint '{endless[0]}', and the model gives it none")
    return drawn


@dataclass(frozen=True)
class Margins:
    """Margins in addition to the planning ranges.

    Attributes:
        foot_load: smallest load of each foot [N].
        foot_moment: s.d. of each foot's tilting moment about its prediction, by dry friction and tracking
            errors in a stiff closed chain; soles keep it with the same assurance [N m]. TULip's drives (0.8
            of their dry friction, command errors of 0.5 mrad) give 0.5 about x and 0.6 about y.
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
    """Return the margins of the [planning] table of the robot's description, or else those of its size."""
    model, leg = robot.model, leg_length(robot)
    weight = float(model.body_subtreemass[0] * -model.opt.gravity[2])
    foot = float(np.ptp(sole_corners(model, robot.stance_foot)[:, 0]))
    sized = {
        "foot_load": FOOT_LOAD * weight,
        "foot_moment": FOOT_MOMENT * weight * foot,
        "link_clearance": CLEARANCE * leg,
        "lifted": LIFTED * leg,
    }
    table = robot.settings.get("planning", {})
    where = f"{robot.path}: [planning]: key"
    stated = {key: _stated(f"{where} '{key}'", table[key]) for key in MARGIN_KEYS if key in table}
    return Margins(**{name: float(f"{value:.{DIGITS}g}") for name, value in sized.items()} | stated)


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
