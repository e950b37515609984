"""A plan that moves: free motions between the postures of every placement, at a speed that fits a budget."""

from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.progress import Advance, Progress, silent
from tulip_testbed.base.result import Outside, Result
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.defaults import MOTION_SPEED
from tulip_testbed.experiments.described_plan import planned_noise
from tulip_testbed.experiments.protocols.measuring_order import stances_in_order
from tulip_testbed.experiments.protocols.motion import FREE, MotionPlanner
from tulip_testbed.experiments.protocols.protocol_run import FASTEST, SLOWEST
from tulip_testbed.experiments.usable_plan import check_measurable
from tulip_testbed.identification.feasibility import stability_margin, support_polygon
from tulip_testbed.identification.preflight.motion_checks import FAST, TOO_FAST
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.measurements.trajectory import RATE, Trajectory
from tulip_testbed.sim.plan_folder import check_fits
from tulip_testbed.sim.robot import Robot

MOST_MINUTES = 60.0  # of 64 MB, a file
TOGETHER = 12  # most postures on one foot that share a placement


@dataclass(frozen=True, eq=False, repr=False)
class MotionPlan(Result):
    """A plan that moves.

    Attributes:
        segments: how many motions without interruption there are. samples: of all of them.
        minutes: time of motion. limit: of the fastest joint, as it was asked for [rad/s].
        fastest_joint, fastest: and its speed [rad/s].
        zmp_margin: least margin of the zero-moment point inside the support polygon [m].
        inertial_mm: root mean square of what accelerations add to the centre of pressure, by CAD [mm].
        preset, noise_mm: of the sensors, and the s.d. that their noise gives a row's centre of pressure [mm].
        left_out: how many motions between postures, by what keeps the robot from making them on its feet.
        plan: the postures, with their motion.
        notes: where the plan is, and what became of the budget.
    """

    segments: int
    samples: int
    minutes: float
    limit: float
    fastest_joint: str
    fastest: float
    zmp_margin: float
    inertial_mm: float
    preset: str
    noise_mm: float
    left_out: dict[str, int]
    plan: Annotated[PosturePlan, Outside()]
    notes: tuple[str, ...] = ()

    def tables(self) -> list[Table | str]:
        rows = {
            "segments": f"{self.segments}",
            "time of motion": f"{self.minutes:.1f} min ({self.samples} samples)",
            "fastest joint": f"{self.fastest_joint}, {self.fastest:.2f} rad/s (at most {self.limit:g})",
            "least margin of the zero-moment point": f"{1e3 * self.zmp_margin:.0f} mm",
            "centre of pressure by accelerations": f"{self.inertial_mm:.2g} mm r.m.s., "
            f"{self.inertial_mm / self.noise_mm:.2g} of the noise ({self.preset}: {self.noise_mm:.2g} mm)",
        }
        rows |= {f"motions left out: {cause}": f"{count}" for cause, count in self.left_out.items()}
        table = Table("Motion", ("what", "value"), [list(row) for row in rows.items()])
        return [table, *self.notes]


def moving_plan(
    robot: Robot,
    plan: PosturePlan,
    minutes: float | None = None,
    speed: float = MOTION_SPEED,
    sensors: str = "wii",
    progress: Progress = silent,
) -> MotionPlan:
    """Join the postures of every placement by free motions; see `tulip_testbed.plan_motion`."""
    bounds = {"speed": (speed, SLOWEST, FASTEST), "minutes": (minutes, 0.0, MOST_MINUTES)}
    for name, (value, low, high) in bounds.items():
        if value is not None and not low < value <= high:
            raise InputError(f"{name}: found {value:g}, expected more than {low:g} and at most {high:g}")
    check_fits("plan", plan, robot)
    check_measurable(robot)
    _, first = np.unique(np.column_stack([plan.placement, plan.posture]), axis=0, return_index=True)
    plan = _gathered(plan.take(np.sort(first)))  # in motion nothing is repeated
    planner = MotionPlanner(robot, plan, speed)
    stances = [*stances_in_order(planner, list(dict.fromkeys(plan.placement.tolist())), progress)]
    ways, left_out = list[list[tuple[int, int]]](), Counter[str]()
    for rows in stances:
        ways.append([])
        for start, end in pairwise(rows.tolist()):
            if planner.way(start, end)[1] == FREE:
                ways[-1].append((start, end))
            else:
                left_out[planner.lacks(start, end)] += 1
                ways.append([])
    ways = [way for way in ways if way]
    if not ways:
        causes = "; ".join(f"{count}: {cause}" for cause, count in left_out.items())
        raise InputError(
            "plan: found no motion that the robot can make on its own feet "
            f"({causes or 'one posture per placement'}), expected one"
        )
    at_limit = sum(planner.way(*step)[0] for way in ways for step in way) / 60
    slower = 1.0 if minutes is None else max(1.0, minutes / at_limit)
    with progress("segments of the motion", len(ways), 0) as advance:
        motion, margin, inertial = _trajectory(planner, ways, slower, advance)
    joint, fastest = motion.fastest
    made = plan.made | {"motion": {"speed": speed, "minutes": motion.seconds / 60}}
    own = planned_noise(robot, plan, sensors).own
    noise = float(np.sqrt(np.trace(own, axis1=1, axis2=2).mean() / 2))
    moving = replace(plan.take(np.concatenate(stances)), made=made, motion=motion)
    notes = (TOO_FAST,) if inertial > FAST * noise else ()
    if minutes is not None:
        short = at_limit > minutes
        budget = f", more than {minutes:g}." if short else f"; they are {slower:.1f} times slower."
        notes = (f"At {speed:g} rad/s the motions take {at_limit:.1f} min{budget}", *notes)
    return MotionPlan(
        segments=len(motion.segments),
        samples=len(motion),
        minutes=motion.seconds / 60,
        limit=speed,
        fastest_joint=plan.joints[joint],
        fastest=fastest,
        zmp_margin=margin,
        inertial_mm=1e3 * inertial,
        preset=sensors,
        noise_mm=1e3 * noise,
        left_out=dict(left_out),
        plan=moving,
        notes=notes,
    )


def _gathered(plan: PosturePlan) -> PosturePlan:
    """Return a plan in which postures on one foot share placements; those of `plan_optimal` share none.

    A placement is that of its first posture. Only postures that are alone on theirs are gathered, of one foot
    and with the plates at one place.
    """
    alone = (plan.placement[:, None] == plan.placement).sum(axis=1) == 1
    placement, groups = plan.placement.copy(), dict[tuple, list[int]]()
    for row in np.flatnonzero(alone & (plan.support != "double")).tolist():
        groups.setdefault((str(plan.support[row]), *plan.swing_pose[row].tolist()), []).append(row)
    for rows in groups.values():
        for some in np.array_split(rows, -(-len(rows) // TOGETHER)):
            placement[some] = placement[some[0]]
    return replace(plan, placement=placement)


def _trajectory(
    planner: MotionPlanner, ways: list[list[tuple[int, int]]], slower: float, advance: Advance
) -> tuple[Trajectory, float, float]:
    """Return the trajectory of motions between rows.

    Two numbers follow: the least margin of the zero-moment point, and the root mean square of its distance
    from the centre of mass [m].

    Args:
        ways: of every segment. slower: factor of the durations at the limit of the speed.
        advance: called after every segment.
    """
    plan, parts, now, least, added = planner.plan, [], 0.0, np.inf, []
    for number, way in enumerate(ways, 1):
        row = way[0][0]
        there = [planner.angles(start, end, RATE, slower) for start, end in way]
        angles = np.concatenate([plan.joint_angles[[row]], *there])
        time = now + np.arange(len(angles)) / RATE
        support = str(plan.support[row])
        loads = planner.loads.at(time, angles, support)
        soles = loads.soles[0, feet_in_contact(np.array([support]))[0], :, :2]
        added.append(loads.zmp - loads.com)
        least = min(least, float(stability_margin(loads.zmp, support_polygon(soles))))
        numbers = np.full((2, len(time)), [[number], [plan.placement[row]]])
        parts.append((time, *numbers, np.full(len(time), support), angles, loads.torques))
        now = float(time[-1]) + 1 / RATE
        advance(1)
    inertial = float(np.sqrt((np.concatenate(added) ** 2).mean()))
    return Trajectory(*(np.concatenate(column) for column in zip(*parts, strict=True))), least, inertial
