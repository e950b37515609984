"""Motions from one posture to the next while the feet stay where they are, and their files."""

import io
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import yaml

from tulip_testbed.experiments.defaults import SPEED
from tulip_testbed.experiments.protocols.motion_loads import LoadsInMotion
from tulip_testbed.identification.feasibility import place_polygon, stability_margin, support_polygon
from tulip_testbed.identification.inverse_kinematics import InverseKinematics
from tulip_testbed.identification.link_clearances import clearances_at, link_pairs, reference_posture
from tulip_testbed.identification.link_paths import SHARE, path_clearances
from tulip_testbed.identification.planning.one_foot import with_feet_exchanged
from tulip_testbed.identification.planning_ranges import planning_margins, planning_ranges
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.data import base_foot, feet_in_contact
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.path import smooth_path, straight_path
from tulip_testbed.sim.robot import Robot, joint_ranges

TORQUE_SHARE = 0.95  # of a drive's limit, dry friction included; the rest is the servo's
ROUNDING = 1e-4  # m, rad, by which a planned posture may touch its own margins

RANGE, LINKS = "joint range", "distance of links"
GEOMETRIC = (RANGE, LINKS)
TORQUE, SUPPORT = "torque", "margin of the CoM and the zero-moment point"
SOLE, LIFTED = "load inside each sole", "height of the foot in the air"
SHORTEST, LONGEST = 2.0, 30.0  # s, of a motion without a stop
STILL = 1e3  # s, of a motion without any inertial force
SLOWER = 1.3  # times the duration, where a faster motion exceeds a limit
INSTANTS = 61  # of a motion without a stop that are looked at
RATE, STRIDE = 50, 5  # samples a second of a trajectory; samples from one point of a message to the next
LOWERED = (1.0, 0.97, 0.94, 0.9)  # heights of the centre of mass in the stance on the way, of that of `stand`
FREE, HOIST, LIFT = "free", "hoist", "lift"
DIGITS = 6  # of an angle [rad], its derivatives and a torque, in a file


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion from one row of a plan to another.

    Attributes:
        start, end: numbers of the postures.
        placement: number of the placement.
        kind: "free": the robot carries itself; "hoist": it hangs in a hoist while its feet stay in place.
        via_stance: whether it stops in a stance on the way.
        times: (k,) [s]. angles, speeds, accelerations: (k, n) [rad, rad/s, rad/s2].
        torques: of the drives by inverse dynamics, (k, n) [N m].
        room: least room that every limit leaves, by its name [rad, m, -].
        reason: what keeps it from being free, or "".
    """

    start: int
    end: int
    placement: int
    kind: str
    via_stance: bool
    times: np.ndarray
    angles: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    torques: np.ndarray
    room: dict[str, float]
    reason: str

    @property
    def duration(self) -> float:
        return float(self.times[-1])

    def name(self, number: int) -> str:
        """Return the name of its files without ending: its number in the order and both postures."""
        return f"{number:03d}-from-{self.start}-to-{self.end}"

    def csv(self, joints: tuple[str, ...]) -> str:
        """Return it as CSV: time [s], then q, qd, qdd and torque of every joint [rad, s, N m].

        In the hoist, which carries an unknown part of the robot, there are no torques.
        """
        groups = [("q", self.angles), ("qd", self.speeds), ("qdd", self.accelerations)]
        groups += [("torque", self.torques)] if self.kind == FREE else []
        header = ",".join(["time", *(f"{name}.{joint}" for name, _ in groups for joint in joints)])
        table, out = np.column_stack([self.times, *(values for _, values in groups)]), io.StringIO()
        np.savetxt(out, _rounded(table), fmt=f"%.{DIGITS}f", delimiter=",", header=header, comments="")
        return out.getvalue()

    def yaml(self, joints: tuple[str, ...]) -> str:
        """Return it as ROS 2's JointTrajectory; quintic splines between its points follow the motion."""
        points = []
        for k in range(0, len(self.times), STRIDE):
            nanoseconds = round(float(self.times[k]) * 1e9)
            points.append(
                {
                    "positions": _rounded(self.angles[k]).tolist(),
                    "velocities": _rounded(self.speeds[k]).tolist(),
                    "accelerations": _rounded(self.accelerations[k]).tolist(),
                    "effort": _rounded(self.torques[k]).tolist() if self.kind == FREE else [],
                    "time_from_start": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
                }
            )
        stamp = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        message = {"header": stamp, "joint_names": list(joints), "points": points}
        style = {"Dumper": yaml.CSafeDumper, "sort_keys": False, "default_flow_style": None, "width": 10**6}
        return yaml.dump(message, **style)


def _rounded(values: np.ndarray) -> np.ndarray:
    return np.round(values, DIGITS) + 0.0  # no minus zero


@dataclass(frozen=True, eq=False)
class _Leg:
    """A motion without a stop: joint angles over a time from 0 to 1, its duration [s] and its room."""

    path: Callable[..., np.ndarray]
    duration: float
    room: dict[str, float]

    @property
    def lacks(self) -> list[str]:
        return [name for name, value in self.room.items() if value < 0]


class MotionPlanner:
    """Plans motions between postures; a class because it keeps MuJoCo's data and its answers.

    Of the margins that plans keep at rest, motions keep half, but all of that of stability.

    Attributes:
        ranges: of the joints, (n, 2) [rad]. drives: largest torques, (n,) [N m].
        stability_margin: of the centre of mass and the zero-moment point inside the support polygon [m].
        sole_margin: of the load's point inside each sole [m]. lifted: least height of a foot in the air [m].
        pairs: links that must keep a distance, in the frame of the right and of the left foot.
    """

    def __init__(self, robot: Robot, plan: PosturePlan, speed: float = SPEED):
        self.plan, self.speed = plan, speed
        margins = planning_margins(robot)
        planned = planning_ranges(robot) if "planning" in robot.settings else None
        self.ranges, self.drives = joint_ranges(robot.model), torque_limits(robot)
        self.stability_margin = 0.0 if planned is None else planned.stability_margin
        self.sole_margin = 0.0 if planned is None else SHARE * planned.sole_margin
        self.lifted = SHARE * margins.lifted
        feet = (robot, with_feet_exchanged(robot))
        self.pairs = [link_pairs(one, margins.link_clearance) for one in feet]
        self.loads = LoadsInMotion(robot)
        self.inverse = InverseKinematics(robot, robot.model)
        self.soles = [corners[:, :2] for corners in self.loads.corners]
        self.standing = self.loads.position(reference_posture(robot), 0)
        self.height = self.loads.height(self.standing)
        self.legs: dict[tuple[int, int], tuple[list[_Leg], str]] = {}

    def least_duration(self, start: int, end: int) -> float:
        """Return the duration of a motion between two rows by the speed of the joints alone [s]."""
        turn = np.abs(self.plan.joint_angles[end] - self.plan.joint_angles[start]).max()
        return max(SHORTEST, 1.875 * float(turn) / self.speed)

    def way(self, start: int, end: int) -> tuple[float, str]:
        """Return duration [s] and kind of the motion between two rows of one placement and support."""
        legs, kind = self._legs(start, end)
        return sum(leg.duration for leg in legs), kind

    def lacks(self, start: int, end: int) -> str:
        """Return what keeps the motion between two rows from being free; "" if nothing does."""
        legs, _ = self._legs(start, end)
        return ", ".join(dict.fromkeys(name for leg in legs for name in leg.lacks))

    def angles(self, start: int, end: int, rate: float, slower: float) -> np.ndarray:
        """Return the joint angles between two rows, at a rate [Hz] and without the first, (k, n) [rad]."""
        legs, _ = self._legs(start, end)
        counts = [int(np.ceil(slower * leg.duration * rate)) for leg in legs]
        parts = (leg.path(np.arange(1, n + 1) / n) for leg, n in zip(legs, counts, strict=True))
        return np.concatenate(list(parts))

    def motion(self, start: int, end: int) -> Motion:
        """Return the motion between two rows of one placement and support."""
        legs, kind = self._legs(start, end)
        plan, support = self.plan, str(self.plan.support[start])
        parts, before = [], 0.0
        for k, leg in enumerate(legs):
            part = np.linspace(0.0, 1.0, STRIDE * round(leg.duration * RATE / STRIDE) + 1)
            at, angles = part * leg.duration, leg.path(part)
            speeds, accelerations = leg.path(part, 1) / leg.duration, leg.path(part, 2) / leg.duration**2
            torques = self.loads.at(at, angles, support).torques
            first = int(k > 0)  # the stop on the way is the end of the leg before
            parts.append([values[first:] for values in (before + at, angles, speeds, accelerations, torques)])
            before += leg.duration
        room = {name: min(leg.room[name] for leg in legs) for name in legs[0].room}
        ends = (int(plan.posture[start]), int(plan.posture[end]), int(plan.placement[start]))
        times, angles, speeds, accelerations, torques = map(np.concatenate, zip(*parts, strict=True))
        way = (times, angles, speeds, accelerations, torques)
        return Motion(*ends, kind, len(legs) > 1, *way, room, self.lacks(start, end))

    def _legs(self, start: int, end: int) -> tuple[list[_Leg], str]:
        """Return the legs of the motion between two rows, and its kind.

        The straight way of the torso is preferred, then one by a stance between the feet. If neither keeps
        all limits, the robot hangs in a hoist on the first way that keeps ranges and distances of links.
        """
        if (start, end) in self.legs:
            return self.legs[start, end]
        first, last = self.plan.joint_angles[[start, end]]
        support = str(self.plan.support[start])
        still = [
            self.dynamic_room(STILL * np.arange(3), np.tile(angles, (3, 1)), support)
            for angles in (first, last)
        ]
        held = min(min(room.values()) for room in still) >= 0
        way, direct = None, None
        for height in (None, *LOWERED) if support == "double" else (None,):
            places = [first, last]
            if height is not None:
                stance = self.stance(self.plan.swing_pose[start], height, (first + last) / 2)
                if stance is None:
                    continue
                places.insert(1, stance)
            legs = [self._leg(a, b, support) for a, b in pairwise(places)]
            direct = direct or (legs, LIFT)
            if not any(leg.lacks for leg in legs):
                way = legs, FREE
                break
            if way is None and not any(leg.room[name] < 0 for leg in legs for name in GEOMETRIC):
                way = legs, HOIST
                if not held:  # no way is free
                    break
        assert direct is not None
        self.legs[start, end] = way or direct
        return self.legs[start, end]

    def stance(self, swing_pose: np.ndarray, lowered: float, angles: np.ndarray) -> np.ndarray | None:
        """Return an upright posture with the centre of mass between the feet, (n,) [rad]; None: out of reach.

        Args:
            swing_pose: (3,) [m, m, rad].
            lowered: height of the centre of mass over that of `stand`.
            angles: joints that are not between the feet stay there, (n,) [rad].
        """
        guess = self.standing.copy()
        free = ~self.loads.coupled
        guess[self.loads.qpos[free]] = angles[free]
        poses = zip(self.soles, (np.zeros(3), swing_pose), strict=True)
        both = np.array([place_polygon(sole, pose) for sole, pose in poses])
        com = np.array([*both.mean(axis=(0, 1)), lowered * self.height])
        return self.inverse.solve(swing_pose, com, np.array([0.0, 0.0, swing_pose[2] / 2]), guess)

    def _leg(self, start: np.ndarray, end: np.ndarray, support: str) -> _Leg:
        between = self.loads.path if support == "double" else straight_path
        base = int(base_foot(np.array([support]))[0])
        path = smooth_path(start, between, end, 1.0)
        part = np.linspace(0.0, 1.0, INSTANTS)
        angles, (low, high), pairs = path(part), self.ranges.T, self.pairs[base]
        within = SHARE * float(pairs.needed.max(initial=0.0))
        # Links that are nearer at an end than what they should keep need not be farther on the way.
        ends = clearances_at(pairs, np.array([start, end]), within).distance.min(axis=0)
        distance = path_clearances(pairs, between, start, end, within).distance
        spare = distance - np.minimum(SHARE * pairs.needed, ends)
        room = {
            RANGE: float(np.minimum(angles - low, high - angles).min()) + ROUNDING,
            LINKS: float(spare.min(initial=within)) + ROUNDING,
        }
        duration = max(SHORTEST, float(np.abs(path(part, 1)).max()) / self.speed)
        slowest = self.dynamic_room(part * STILL, angles, support)
        slower = duration
        while min(slowest.values()) >= 0 and slower < LONGEST:
            faster = self.dynamic_room(part * slower, angles, support)
            if min(faster.values()) >= 0:
                return _Leg(path, slower, room | faster)
            slower *= SLOWER
        return _Leg(path, duration, room | self.dynamic_room(part * duration, angles, support))

    def dynamic_room(self, times: np.ndarray, angles: np.ndarray, support: str) -> dict[str, float]:
        """Return how much room torques [-], stability and soles [m] leave; negative: too little.

        Args:
            times: instants at equal distances, (k,) [s]. angles: (k, n) [rad].
            support: "double", "right" or "left".
        """
        loads = self.loads.at(times, angles, support)
        stands = feet_in_contact(np.array([support]))[0]
        soles = loads.soles[0, stands, :, :2]
        used = ((np.abs(loads.torques) + np.abs(loads.friction)) / self.drives).max()
        polygon = support_polygon(soles)
        inside = stability_margin(np.concatenate([loads.com, loads.zmp]), polygon)  # of the nearest
        room = {TORQUE: TORQUE_SHARE - float(used), SUPPORT: inside - self.stability_margin + ROUNDING}
        if stands.all():
            on_soles = [
                stability_margin(loads.foot_points[:, side], support_polygon(sole))
                for side, sole in enumerate(soles)
            ]
            room[SOLE] = min(on_soles) - self.sole_margin + ROUNDING
        else:
            room[LIFTED] = float(loads.soles[:, ~stands, :, 2].min()) - self.lifted
        return room
