"""Follow the motions of protocols in the full dynamics (docs/studies/protocol.md; 10 minutes).

The robot is put down in the first posture of a placement, held by clamps as by a hoist, and let go. From
there on it stands on its own feet: its servos get the trajectories' angles, led by their derivative time as
in the laboratory, and the trajectories' torques. Where the protocol states a hoist, it pulls the free body up
with 30 % of the weight, the feet are clamped for the motion, and there are no torques. Nothing is hidden: the
robot is the nominal one; its drives have dry friction, which no trajectory knows of.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

import tulip_testbed as tt
from studies.runner import Settings, header, row
from tests.foreign_robots import write_robot
from tulip_testbed.experiments.protocols.motion import FREE, HOIST, Motion
from tulip_testbed.experiments.protocols.protocol_run import LaboratoryProtocol, ProtocolSettings, protocol_of
from tulip_testbed.experiments.usable_plan import random_plan
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.dynamics.hold import SERVO_PERIOD, clamp, put_down, release
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, load_robot

HUMANOID = "humanoid"
SET_DOWN = "set down"
WORDS = {FREE: "on its own feet", HOIST: "in the hoist", SET_DOWN: "set down again"}
PARTS = ("optimal", "random", "mixed", HUMANOID)
SETTINGS = Settings(seed=1, only=PARTS)
PLACEMENTS, POSTURES = 20, 5  # of the humanoid's random plan
REST = 1.0  # s, after a motion
LOST = 1e-3  # m, of a sole's corner over its board: the foot is lost
HOISTED = 0.3  # of the weight, that a hoist carries; boards with little load would come off
LOOK = 5  # servo periods between two looks


@dataclass(frozen=True)
class Followed:
    """The events of one motion.

    Attributes:
        kind: as the protocol states it.
        lost: whether a foot or the balance was lost on the way. fell: whether it was lost then.
        gap: largest height of a sole's corner over its board on the way [m].
        slip: distance that a foot moved by [m].
        error: largest error of a joint's angle [rad].
        torque: largest torque of a drive over its limit [-].
        still: whether the posture could be measured then: no corner and no cell lifted.
    """

    kind: str
    lost: bool
    fell: bool
    gap: float
    slip: float
    error: float
    torque: float
    still: bool


def follow(stand: Stand, motion: Motion) -> Followed:
    """Let the robot follow a motion."""
    hung = motion.kind != FREE
    stand.stiction.release(stand.data)
    before = stand.command
    if hung:
        stand.mark_feet()
        clamp(stand)
    times = np.arange(1, round(motion.duration / SERVO_PERIOD) + 1) * SERVO_PERIOD
    angles = CubicHermiteSpline(motion.times, motion.angles, motion.speeds)
    torques = make_interp_spline(motion.times, motion.torques * (not hung), k=1)
    lead, limit = stand.rig.controller.derivative_time, stand.model.actuator_forcerange[stand.servos, 1]
    commands = angles(times) + lead * angles(times, 1) + stand.offset(torques(times))
    slowly = np.linspace(0.0, 1.0, round(REST / SERVO_PERIOD))
    for part in slowly:  # from the torques of before to these
        stand.command = (1 - part) * before + part * commands[0]
        hoist(stand, part * hung)
    stand.mark_feet()
    gap = error = torque = 0.0
    for k, (command, wanted) in enumerate(zip(commands, angles(times), strict=True)):
        stand.command = command
        hoist(stand, float(hung))
        if k % LOOK == 0:
            gap = max(gap, stand.highest_corner())
            error = max(error, float(np.abs(stand.data.qpos[stand.qpos] - wanted).max()))
            torque = max(torque, float(np.abs(stand.data.actuator_force[stand.servos] / limit).max()))
    upright = stand.chain.base_pose(motion.angles[-1], stand.base)
    lost = gap > LOST or stand.tipped(upright)
    for part in slowly:
        hoist(stand, (1 - part) * hung)
    stand.run(REST)
    if hung:
        release(stand)
        stand.run(REST)
    slip, fell = stand.drift(), stand.tipped(upright)
    still = stand.fault() is None and not fell
    return Followed(motion.kind, bool(lost), bool(fell), gap, slip, error, torque, still)


def hoist(stand: Stand, part: float) -> None:
    """Run for a servo period while a hoist pulls the free body up with a part of what it may carry."""
    weight = stand.model.body_subtreemass[stand.torso] * -stand.model.opt.gravity[2]
    pull = part * HOISTED * weight
    stand.data.xfrc_applied[stand.torso, 2] += pull
    stand.run(SERVO_PERIOD)
    stand.data.xfrc_applied[stand.torso, 2] -= pull


def placement(protocol: LaboratoryProtocol, number: int) -> list[Followed]:
    """Follow the motions of one placement until the robot falls."""
    plan, rig, found = protocol.plan, preset_rig("ideal", protocol.robot), []
    rows = np.flatnonzero(plan.placement == number)
    stand = Stand(rig, protocol.boards[rows[0]])
    for k in rows.tolist():
        motion = protocol.motions[k]
        if motion is not None:
            found.append(follow(stand, motion))
            if found[-1].fell:
                break
            continue
        following = protocol.motions[k + 1] if k + 1 < len(plan) else None
        torques = following.torques[0] if following and following.kind == FREE else plan.feed_forward[k]
        angles = plan.joint_angles[k]
        put_down(stand, angles, str(plan.support[k]), angles + stand.offset(torques))
        release(stand)
        stand.run(REST)
        fell = stand.tipped(stand.chain.base_pose(angles, stand.base))
        still = stand.fault() is None and not fell
        found.append(Followed(SET_DOWN, False, bool(fell), 0.0, 0.0, 0.0, 0.0, still))
        if fell:
            break
    return found


def humanoid(seed: int, placements: int) -> tuple[Robot, PosturePlan]:
    """Return a humanoid with arms, which nobody here wrote, and a random plan."""
    robot = load_robot(write_robot(HUMANOID, Path(tempfile.mkdtemp()) / HUMANOID))
    return robot, random_plan(robot, placements, POSTURES, seed)


def study(settings: Settings) -> Iterator[str]:
    """Yield a row for every plan and kind of motion."""
    yield header(
        "plan",
        "motions",
        "number",
        "lost a foot on the way",
        "fell then",
        "could be measured then",
        "highest corner, mm",
        "largest slip, mm",
        "largest error, mrad",
        "largest torque, of the limit",
    )
    for name in settings.only:
        if name == HUMANOID:
            robot, plan = humanoid(settings.seed, max(settings.count(PLACEMENTS), 5))
        else:
            robot, plan = load_robot(), getattr(tt.plans, name)
            numbers = np.unique(plan.placement)
            plan = plan.take(np.isin(plan.placement, numbers[: settings.count(len(numbers))]))
        protocol = protocol_of(robot, plan, ProtocolSettings())
        jobs = ((protocol, number) for number in protocol.placements)
        found = [one for some in settings.parallel(name, placement, jobs) for one in some]
        for kind in WORDS:
            some = [one for one in found if one.kind == kind]
            if not some:
                continue
            figures = (
                f"{1e3 * max(one.gap for one in some):.2f}",
                f"{1e3 * max(one.slip for one in some):.2f}",
                f"{1e3 * max(one.error for one in some):.1f}",
                f"{max(one.torque for one in some):.2f}",
            )
            counts = (sum(getattr(one, key) for one in some) for key in ("lost", "fell", "still"))
            on_the_way = ("",) * len(figures) if kind == SET_DOWN else figures
            yield row(name, WORDS[kind], len(some), *counts, *on_the_way)
