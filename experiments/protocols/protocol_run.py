"""The protocol of a laboratory day: a plan in the order in which it is measured, and the motions between."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError, at_least, look_up
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.defaults import REPEATS, SPEED
from tulip_testbed.experiments.protocols.measuring_order import (
    REFUSED,
    drift_inflation,
    marks_moved,
    order_of_placement,
    order_of_placements,
    with_own_repeats,
)
from tulip_testbed.experiments.protocols.motion import FREE, HOIST, LIFT, Motion, MotionPlanner
from tulip_testbed.identification.link_clearances import clearances_at
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.plan_folder import check_fits
from tulip_testbed.sim.rig import Protocol as Procedure
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.robot_check import warn_of_robot
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.scene_check import check_scene
from tulip_testbed.sim.sensors import PRESETS

FASTEST = 10.0  # rad/s
HOISTED = 10.0  # s more than the motion itself, to take the load off the robot: prefers free motions


@dataclass(frozen=True)
class ProtocolSettings:
    """The settings that the user of a laboratory may choose.

    Attributes:
        sensors: preset whose data sheet starts the measurement folder; None: unknown.
        speed: largest speed of a joint on a motion [rad/s].
        repeats: postures that are measured twice if the plan repeats none; at most every fifth.
    """

    sensors: str | None = None
    speed: float = SPEED
    repeats: int = REPEATS


@dataclass(frozen=True, eq=False, repr=False)
class LaboratoryProtocol(Result):
    """A plan in the order in which it is measured, with the motion to every row.

    Attributes:
        given: the plan in its own order, with repeats.
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
    settings: ProtocolSettings
    motions: tuple[Motion | None, ...]
    boards: np.ndarray
    notes: tuple[str, ...]
    folder: Path | None = None
    missing: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @property
    def placements(self) -> list[int]:
        """Return the numbers of the placements in order."""
        return list(dict.fromkeys(self.plan.placement.tolist()))

    def to_json(self) -> dict[str, Any]:
        """Return the order and what is to be known of it, for JSON."""
        plan, kinds = self.plan, self._kinds()
        return {
            "robot": self.robot.model_file.name,
            "postures": plan.postures,
            "rows": len(plan),
            "placements": self.placements,
            "order": plan.posture.tolist(),
            "placement_of_row": plan.placement.tolist(),
            "motions": dict(kinds),
            "motion_minutes": sum(m.duration for m in self.motions if m) / 60,
            "hours": self.hours,
            "marks_moved_mm": {"plan": self._moved(self.given), "protocol": self._moved(plan)},
            "drift_inflation": {
                "plan": drift_inflation(self.robot, self.given),
                "protocol": drift_inflation(self.robot, plan),
            },
            "notes": list(self.notes),
            "missing": list(self.missing),
            "files": list(self.files),
        }

    @property
    def hours(self) -> float:
        """Return the assumed length of the day, by the times of the simulated laboratory [h]."""
        p = Procedure()
        set_downs = sum(motion is None for motion in self.motions)
        held = len(self.plan) * (p.rest_time + p.hold_time)
        return (set_downs * p.placement_time + held + sum(m.duration for m in self.motions if m)) / 3600

    def tables(self) -> list[Table | str]:
        """Return a summary and what a person should know."""
        content = self.to_json()
        kinds, moved, drift = content["motions"], content["marks_moved_mm"], content["drift_inflation"]
        rows = [
            ["rows to measure", f"{content['rows']} ({content['postures']} postures)"],
            ["placements", str(len(content["placements"]))],
            ["motions on the robot's own feet", str(kinds["free"])],
            ["of them by a stance between the feet", str(kinds["via_stance"])],
            ["motions in the hoist, feet in place", str(kinds["hoist"])],
            ["times that the robot is set down again", str(kinds["set_down"])],
            [
                "assumed length",
                f"{content['hours']:.1f} h, {content['motion_minutes']:.0f} min of it motions",
            ],
            [
                "way of boards and marks",
                f"{moved['protocol']:.0f} mm ({moved['plan']:.0f} in the plan's order)",
            ],
            [
                "s.e. of a linear drift, over that of a drift alone",
                f"{drift['protocol']:.2f} ({drift['plan']:.2f} in the plan's order)",
            ],
        ]
        place = [] if self.folder is None else [f"Protocol: {self.folder}"]
        return [
            Table("Protocol", (Column("what"), Column("value")), rows),
            *self.notes,
            *self.missing,
            *place,
        ]

    def _kinds(self) -> dict[str, int]:
        counts = Counter(motion.kind for motion in self.motions if motion)
        return {
            "free": counts[FREE],
            "via_stance": sum(motion.via_stance for motion in self.motions if motion and motion.kind == FREE),
            "hoist": counts[HOIST],
            "set_down": sum(motion is None for motion in self.motions),
        }

    def _moved(self, plan: PosturePlan) -> float:
        numbers = list(dict.fromkeys(plan.placement.tolist()))
        rows = [int(np.flatnonzero(plan.placement == number)[0]) for number in numbers]
        away = marks_moved(self.robot, plan, rows)
        return float(1e3 * np.diagonal(away, 1).sum())


def protocol_of(
    robot: Robot,
    plan: PosturePlan,
    settings: ProtocolSettings | None = None,
    progress: Progress = silent,
) -> LaboratoryProtocol:
    """Order a plan and plan the motions between its postures.

    Raises:
        InputError: a plan that does not fit the robot, a scene without a laboratory, a setting out of range.
    """
    settings = settings or ProtocolSettings()
    check_settings(settings)
    check_fits("plan", plan, robot)
    check_scene(preset_rig("ideal", robot))
    warn_of_robot(robot)
    extended = with_own_repeats(plan, min(settings.repeats, len(plan) // 5))
    planner = MotionPlanner(robot, extended, settings.speed)

    def way(start: int, end: int) -> float:
        duration, kind = planner.way(start, end)
        return {FREE: duration, HOIST: duration + HOISTED, LIFT: REFUSED}[kind]

    rows: list[int] = []
    with progress("placements", len(np.unique(extended.placement)), 0) as advance:
        for number in order_of_placements(robot, extended):
            there = np.flatnonzero(extended.placement == number)
            for support in dict.fromkeys(extended.support[there].tolist()):
                some = there[extended.support[there] == support]
                rows += order_of_placement(extended, some, way, planner.least_duration).tolist()
            advance(1)
    ordered, motions = _joined(planner, extended, np.array(rows))
    return LaboratoryProtocol(
        robot=robot,
        given=extended,
        plan=ordered,
        settings=settings,
        motions=motions,
        boards=boards_under(preset_rig("ideal", robot), ordered.foot_poses),
        notes=_notes(planner, ordered, motions),
    )


def check_settings(settings: ProtocolSettings) -> None:
    """Refuse settings that no protocol has.

    Raises:
        InputError: names the setting, what was found and what was expected.
    """
    at_least("repeats", settings.repeats, 0)
    if not 0 < settings.speed <= FASTEST:
        raise InputError(f"speed: found {settings.speed:g}, expected above 0 and at most {FASTEST:g} rad/s")
    if settings.sensors is not None:
        look_up("preset", settings.sensors, PRESETS, "sensors")


def _joined(
    planner: MotionPlanner, plan: PosturePlan, rows: np.ndarray
) -> tuple[PosturePlan, tuple[Motion | None, ...]]:
    """Return the plan's rows in order and the motions between them.

    Where the robot has to be lifted off its feet within a placement, a new placement begins: its boards are
    recorded again.
    """
    placement, motions = plan.placement[rows], []
    following, numbers = int(plan.placement.max()) + 1, list(placement)
    for k, row in enumerate(rows):
        before = rows[k - 1] if k else None
        if before is None or placement[k] != placement[k - 1] or plan.support[row] != plan.support[before]:
            motions.append(None)
            current = (
                int(placement[k]) if before is None or placement[k] != placement[k - 1] else numbers[k - 1]
            )
        else:
            found = planner.motion(int(before), int(row))
            current = numbers[k - 1]
            if found.kind == LIFT:
                found, current, following = None, following, following + 1
            motions.append(found)
        numbers[k] = current
    ordered = replace(plan.take(rows), placement=np.array(numbers))
    return replace(ordered, made=plan.made | {"protocol": {"speed": planner.speed}}), tuple(motions)


def _notes(planner: MotionPlanner, plan: PosturePlan, motions: tuple[Motion | None, ...]) -> tuple[str, ...]:
    """Tell of postures whose links overlap and of motions in the hoist."""
    notes = []
    _, once = np.unique(plan.posture, return_index=True)
    for base in (0, 1):
        rows = once[base_foot(plan.support[once]) == base]
        pairs = planner.limits.pairs[base]
        if len(rows) and len(pairs.names):
            distance = clearances_at(pairs, plan.joint_angles[rows], 0.0).distance
            for k in np.flatnonzero(distance.min(axis=1) < -1e-4):
                pair = int(distance[k].argmin())
                links = " and ".join(pairs.names[pair])
                notes.append(
                    f"Posture {plan.posture[rows[k]]}: the shapes of {links} overlap by "
                    f"{-1e3 * distance[k, pair]:.1f} mm in the model: look before you let the robot go there."
                )
    hung = [motion for motion in motions if motion and motion.kind == HOIST]
    notes += [
        f"Motion from posture {m.start} to {m.end}: in the hoist. On its own feet the robot would break a "
        f"limit: {m.reason}."
        for m in hung
    ]
    return tuple(notes)
