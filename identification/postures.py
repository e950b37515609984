"""Draw random feasible postures (section IV, steps 1 to 5)."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.identification.feasibility import (
    boards_fit,
    foot_clearance,
    place_polygon,
    predicted_cell_loads,
    predicted_foot_loads,
    stability_margin,
    support_polygon,
)
from tulip_testbed.identification.inverse_kinematics import InverseKinematics
from tulip_testbed.sim.errors import InputError, choices, look_up, most_frequent, shortened
from tulip_testbed.sim.measurements import PlateGeometry, PosturePlan, lay_boards
from tulip_testbed.sim.robot import (
    Robot,
    between_feet,
    joint_names,
    joint_ranges,
    sole_corners,
)

ATTEMPTS = 3000  # without a feasible posture, after which the ranges are considered infeasible
ATTEMPTS_HERE = 200  # for the next posture of a placement, after which the placement is given up
MOST_NUMBER = 1e6  # m, rad, deg, N: bound of any robot's ranges

Range = tuple[float, float]


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


def planning_ranges(robot: Robot) -> PlanningRanges:
    """Read the [planning] table of the robot's description.

    Raises:
        InputError: a key is missing or unknown, or its value is no number or range low <= high.
    """
    where, table = f"{robot.path}: [planning]", robot.settings.get("planning", {})
    fields = {f.name: f for f in dataclasses.fields(PlanningRanges) if f.name != "joints"}
    values: dict[str, Any] = {}
    for key, value in table.items():
        name = key.removesuffix("_deg")
        if name == "joints" and key != name:
            values[name] = _joint_table(where, value)
            continue
        if name not in fields:
            raise InputError(f"{where}: unknown key '{key}'; {choices(key, [*fields, 'joints_deg'])}")
        if name in values:
            raise InputError(f"{where}: found '{name}' and '{name}_deg', expected one of them")
        numbers = _numbers(f"{where}: key '{key}'", value, is_range=fields[name].type == "Range")
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
        low, high = _numbers(f"{where}: key 'joints_deg.{joint}'", value, is_range=True)
        ranges[joint] = (float(np.deg2rad(low)), float(np.deg2rad(high)))
    return ranges


def _numbers(where: str, value: Any, is_range: bool) -> Any:
    """Return the value as a float, or as a list of two in ascending order."""
    numbers = value if is_range and isinstance(value, list) else [value]
    plain = all(type(v) in (int, float) and abs(v) < MOST_NUMBER for v in numbers)  # neither bool nor NaN
    if not plain or len(numbers) != 1 + is_range or numbers[0] > numbers[-1]:
        expected = "[low, high] with low <= high" if is_range else "a number"
        raise InputError(f"{where}: found {shortened(repr(value))}, expected {expected}")
    return [float(v) for v in numbers] if is_range else float(value)


def free_joint_ranges(robot: Robot, model: mujoco.MjModel, ranges: PlanningRanges) -> dict[str, Range]:
    """Return the ranges of the joints that are not between the feet [rad].

    Raises:
        InputError: a range is given for another joint or outside of the model's range, or a joint has no
            range at all.
    """
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


def random_postures(
    robot: Robot,
    plate: PlateGeometry,
    placements: int,
    per_placement: int,
    seed: int,
    ranges: PlanningRanges | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> PosturePlan:
    """Draw feasible postures, `per_placement` on each of `placements` foot placements.

    Args:
        plate: geometry of the boards.
        progress: called with the number of postures each time a placement is complete.

    Raises:
        InputError: no posture is feasible; the message names the violated constraints and their counts.
    """
    model = robot.model
    search = _Search(robot, model, plate, ranges or planning_ranges(robot), np.random.default_rng(seed))
    angles, poses = [], []
    while len(angles) < placements * per_placement:
        found = search.placement(per_placement)
        progress(len(found))
        angles += [q for q, _ in found]
        poses += [pose for _, pose in found]
    count = len(angles)
    return PosturePlan(
        joints=joint_names(model),
        joint_angles=np.array(angles),
        posture=np.arange(1, count + 1),
        placement=np.repeat(np.arange(1, placements + 1), per_placement),
        support=np.full(count, "double"),
        swing_pose=np.array(poses),
        robot={"model": robot.model_file.name, "sha256": robot.model_hash},
        made={
            "objective": "random",
            "seed": seed,
            "placements": placements,
            "per_placement": per_placement,
            "ranges": dataclasses.asdict(search.ranges),
            "attempts": search.attempts,
            "rejected": dict(search.rejected),
        },
    )


class _Search:
    """State of the random search: generator, solver and counts of rejections."""

    def __init__(
        self,
        robot: Robot,
        model: mujoco.MjModel,
        plate: PlateGeometry,
        ranges: PlanningRanges,
        rng: np.random.Generator,
    ):
        self.ranges, self.rng, self.plate, self.model = ranges, rng, plate, model
        self.solver = InverseKinematics(robot, model)
        self.corners = [sole_corners(model, foot)[:, :2] for foot in robot.feet]
        names = joint_names(model)
        self.limits = joint_ranges(model)
        self.names = names
        self.free_joints = free_joint_ranges(robot, model, ranges)
        self.weight = float(model.body_subtreemass[0] * -model.opt.gravity[2])
        self.guess = self._bent_knees()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        ground = _lowest_sole(model, data, robot)
        standing, highest = data.body(self.solver.torso).xpos[2] - ground, data.subtree_com[0, 2] - ground
        # From straight legs down to the least height of the hip; inverse kinematics decides on reachability.
        self.com_height = (highest - max(standing - ranges.least_height, 0.0), highest)
        self.rejected: Counter[str] = Counter()
        self.attempts = 0
        self.found = 0

    def placement(self, wanted: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Carry out steps 1 to 5 for one placement: pairs of joint angles and swing foot pose."""
        while True:
            r = self.ranges
            pose = np.array([self._draw(x) for x in (r.swing_x, r.swing_y, r.swing_yaw)])
            soles = np.array([self.corners[0], place_polygon(self.corners[1], pose)])
            if not self._feet_feasible(soles):
                continue
            accepted, tries = [], 0
            while len(accepted) < wanted:
                angles = self._posture(pose, soles)
                tries = 0 if angles is not None else tries + 1
                if angles is not None:
                    accepted.append((angles, pose))
                elif not accepted or tries > ATTEMPTS_HERE:
                    break  # step 4: back to step 1
            if len(accepted) == wanted:
                self.found += wanted
                return accepted

    def _feet_feasible(self, soles: np.ndarray) -> bool:
        if foot_clearance(*soles) <= max(self.ranges.foot_clearance, 1e-9):
            self._reject("foot clearance")
            return False
        self.boards = lay_boards(soles, self.plate.size, self.ranges.plate_gap)
        if not boards_fit(soles, self.boards, self.plate):
            self._reject("boards do not carry the feet")
            return False
        return True

    def _posture(self, pose: np.ndarray, soles: np.ndarray) -> np.ndarray | None:
        """Attempt steps 3 and 4 once: return joint angles, or None."""
        found = self._try(pose, soles)
        if isinstance(found, str):
            self._reject(found)
            return None
        self.attempts += 1
        return found

    def _try(self, pose: np.ndarray, soles: np.ndarray) -> np.ndarray | str:
        """Return the joint angles of one random draw, or the violated constraint."""
        r = self.ranges
        polygon = support_polygon(soles)
        com = self.rng.uniform(polygon.min(axis=0), polygon.max(axis=0))
        height = self._draw(self.com_height)
        rpy = np.array([self._draw(x) for x in (r.torso_roll, r.torso_pitch, r.torso_yaw)])
        guess = self.guess.copy()
        for name, interval in self.free_joints.items():
            guess[self.model.joint(name).qposadr[0]] = self._draw(interval)
        if stability_margin(com, polygon) < r.stability_margin:
            return "stability margin"
        share, cop = predicted_foot_loads(com, np.array([np.zeros(2), pose[:2]]))
        if min(map(stability_margin, cop, map(support_polygon, soles))) < r.sole_margin:
            return "a sole would lift"
        if predicted_cell_loads(share, cop, self.boards, self.plate, self.weight).min() < r.least_cell_load:
            return "a cell would unload"
        angles = self.solver.solve(pose, np.array([*com, height]), rpy, guess)
        if angles is None:
            return "out of reach"
        outside = (angles < self.limits[:, 0]) | (angles > self.limits[:, 1])
        if outside.any():
            return f"joint limit {self.names[int(outside.argmax())]}"
        if self.solver.height(self.solver.torso) < r.least_height:
            return "least height"
        return angles

    def _draw(self, interval: Range) -> float:
        return float(self.rng.uniform(*interval))

    def _reject(self, reason: str) -> None:
        self.attempts += 1
        self.rejected[reason] += 1
        if self.found == 0 and self.attempts >= ATTEMPTS:
            raise InputError(
                f"{self.solver.robot.path}: planning ranges admit no posture: "
                f"{self.attempts} tries, none feasible; blocked by {most_frequent(self.rejected)}"
            )

    def _bent_knees(self) -> np.ndarray:
        """Return the keyframe `stand`, or the model's zero pose if there is none."""
        keys = [self.model.key(i).name for i in range(self.model.nkey)]
        return self.model.key("stand").qpos.copy() if "stand" in keys else self.model.qpos0.copy()


def _lowest_sole(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> float:
    return min(
        float((data.body(foot).xpos + data.body(foot).xmat.reshape(3, 3) @ corner)[2])
        for foot in robot.feet
        for corner in sole_corners(model, foot)
    )
