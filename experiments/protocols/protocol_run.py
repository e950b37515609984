"""The protocol of a laboratory day: a plan in the order in which it is measured, and the motions between."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError, at_least, look_up
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.defaults import REPEATS, SPEED
from tulip_testbed.experiments.protocols.measuring_order import (
    drift_inflation,
    marks_moved,
    order_of_placements,
    stances_in_order,
)
from tulip_testbed.experiments.protocols.motion import FREE, HOIST, LIFT, Motion, MotionPlanner
from tulip_testbed.experiments.usable_plan import check_measurable
from tulip_testbed.identification.link_clearances import clearances_at
from tulip_testbed.identification.planning.optimal_plan import with_repeats
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.plan_folder import check_fits
from tulip_testbed.sim.rig import Protocol as Procedure
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.sensors import PRESETS

SLOWEST, FASTEST = 1e-2, 10.0  # rad/s


@dataclass(frozen=True, eq=False, repr=False)
class LaboratoryProtocol(Result):
    """A plan in the order in which it is measured, with the motion to every row.

    Attributes:
        given: the plan in its own order, with repeats.
        sensors: preset whose data sheet starts the measurement folder; None: unknown.
        plan: its rows in order, with repeats.
        motions: to every row from the one before, (m,); None: the robot is set down again, held by a hoist.
        boards: poses of right and left board in the base frame of every row, (m, 2, 3) [m, m, rad].
        notes: what a person should know of postures, sentences.
        folder: where it was written; None: nowhere. files: in it.
        missing: pictures that could not be drawn.
    """

    robot: Robot
    given: PosturePlan
    plan: PosturePlan
    sensors: str | None
    motions: tuple[Motion | None, ...]
    boards: np.ndarray
    notes: tuple[str, ...]
    folder: Path | None = None
    missing: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @property
    def placements(self) -> list[int]:
        return list(dict.fromkeys(self.plan.placement.tolist()))

    @property
    def motion_time(self) -> float:
        """Return the duration of all motions [s]."""
        return sum(motion.duration for motion in self.motions if motion)

    @property
    def hours(self) -> float:
        """Return the assumed length of the day, by the times of the simulated laboratory [h]."""
        times = Procedure()
        set_downs = sum(motion is None for motion in self.motions)
        held = len(self.plan) * (times.rest_time + times.hold_time)
        return (set_downs * times.placement_time + held + self.motion_time) / 3600

    def to_json(self) -> dict[str, Any]:
        kinds = Counter(motion.kind if motion else "set_down" for motion in self.motions)
        free = [motion for motion in self.motions if motion and motion.kind == FREE]
        kinds["via_stance"] = sum(motion.via_stance for motion in free)
        both, moved = {"plan": self.given, "protocol": self.plan}, {}
        for name, plan in both.items():
            rows = np.sort(np.unique(plan.placement, return_index=True)[1]).tolist()
            moved[name] = float(1e3 * np.diagonal(marks_moved(self.robot, plan, rows), 1).sum())
        return {
            "robot": self.robot.model_file.name,
            "postures": self.plan.postures,
            "rows": len(self.plan),
            "placements": self.placements,
            "order": self.plan.posture.tolist(),
            "placement_of_row": self.plan.placement.tolist(),
            "motions": {kind: kinds[kind] for kind in (FREE, "via_stance", HOIST, "set_down")},
            "motion_minutes": self.motion_time / 60,
            "hours": self.hours,
            "marks_moved_mm": moved,
            "drift_inflation": {name: drift_inflation(self.robot, plan) for name, plan in both.items()},
            "notes": list(self.notes),
            "missing": list(self.missing),
            "files": list(self.files),
        }

    def tables(self) -> list[Table | str]:
        content = self.to_json()
        kinds, moved, drift = content["motions"], content["marks_moved_mm"], content["drift_inflation"]
        rows = {
            "rows to measure": f"{content['rows']} ({content['postures']} postures)",
            "placements": str(len(content["placements"])),
            "motions on the robot's own feet": str(kinds["free"]),
            "of them by a stance between the feet": str(kinds["via_stance"]),
            "motions in the hoist, feet in place": str(kinds["hoist"]),
            "times that the robot is set down again": str(kinds["set_down"]),
            "assumed length": f"{self.hours:.1f} h, {content['motion_minutes']:.0f} min of it motions",
            "way of boards and marks": (
                f"{moved['protocol']:.0f} mm ({moved['plan']:.0f} in the plan's order)"
            ),
            "s.e. of a linear drift, over that of a drift alone": (
                f"{drift['protocol']:.2f} ({drift['plan']:.2f} in the plan's order)"
            ),
        }
        place = [] if self.folder is None else [f"Protocol: {self.folder}"]
        summary = Table("Protocol", ("what", "value"), list(rows.items()))
        return [summary, *self.notes, *self.missing, *place]


def protocol_of(
    robot: Robot,
    plan: PosturePlan,
    sensors: str | None = None,
    speed: float = SPEED,
    repeats: int = REPEATS,
    progress: Progress = silent,
) -> LaboratoryProtocol:
    """Order a plan and plan the motions between its postures; see `tulip_testbed.protocol`."""
    at_least("repeats", repeats, 0)
    if not SLOWEST <= speed <= FASTEST:
        raise InputError(f"speed: found {speed:g}, expected {SLOWEST:g} to {FASTEST:g} rad/s")
    if sensors is not None:
        look_up("preset", sensors, PRESETS, "sensors")
    check_fits("plan", plan, robot)
    check_measurable(robot)
    count = min(repeats, len(plan) // 5)
    extended = with_repeats(plan, count, 0) if plan.postures == len(plan) and count else plan
    planner = MotionPlanner(robot, extended, speed)
    stances = stances_in_order(planner, order_of_placements(robot, extended), progress)
    ordered, motions = _with_motions(planner, np.concatenate([*stances]))
    return LaboratoryProtocol(
        robot=robot,
        given=extended,
        plan=ordered,
        sensors=sensors,
        motions=motions,
        boards=boards_under(preset_rig("ideal", robot), ordered.foot_poses),
        notes=_notes(planner, ordered, motions),
    )


def _with_motions(planner: MotionPlanner, rows: np.ndarray) -> tuple[PosturePlan, tuple[Motion | None, ...]]:
    """Return the plan's rows in order and the motions between them.

    Where the robot has to be lifted off its feet within a placement, a new placement begins: its boards are
    recorded again.
    """
    plan, placement, motions = planner.plan, planner.plan.placement[rows], []
    following, numbers = int(plan.placement.max()) + 1, placement.tolist()
    for k, row in enumerate(rows):
        motion, moved = None, k == 0 or placement[k] != placement[k - 1]
        if not moved:
            numbers[k] = numbers[k - 1]
            if plan.support[row] == plan.support[rows[k - 1]]:
                motion = planner.motion(int(rows[k - 1]), int(row))
                if motion.kind == LIFT:
                    motion, numbers[k], following = None, following, following + 1
        motions.append(motion)
    ordered = replace(plan.take(rows), placement=np.array(numbers))
    return replace(ordered, made=plan.made | {"protocol": {"speed": planner.speed}}), tuple(motions)


def _notes(planner: MotionPlanner, plan: PosturePlan, motions: tuple[Motion | None, ...]) -> tuple[str, ...]:
    """Tell of postures whose links overlap and of motions in the hoist."""
    notes = []
    _, once = np.unique(plan.posture, return_index=True)
    for base in (0, 1):
        rows = once[base_foot(plan.support[once]) == base]
        pairs = planner.pairs[base]
        if len(rows) and len(pairs.names):
            distance = clearances_at(pairs, plan.joint_angles[rows], 0.0).distance
            for k in np.flatnonzero(distance.min(axis=1) < -1e-4):
                pair = int(distance[k].argmin())
                links = " and ".join(pairs.names[pair])
                notes.append(
                    f"Posture {plan.posture[rows[k]]}: the shapes of {links} overlap by "
                    f"{-1e3 * distance[k, pair]:.1f} mm in the model: look before you let the robot go there."
                )
    notes += [
        f"Motion from posture {motion.start} to {motion.end}: in the hoist. On its own feet the robot would "
        f"break a limit: {motion.reason}."
        for motion in motions
        if motion and motion.kind == HOIST
    ]
    return tuple(notes)
