"""Plans that a robot can be identified from: the shipped ones, random ones, and what is refused."""

import hashlib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError, at_least, at_most, choices
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.table_files import MOST_ROWS
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.rank import labels, require_identifiable
from tulip_testbed.identification.regressor import ENCODER_SD, encoder_blur, stacked_regressor
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.trajectory import Trajectory
from tulip_testbed.sim.plan_folder import check_fits, read_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.robot_check import check_scene, warn_of_robot
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.shipped import PLAN_NAMES, PLANS, plan_folder

DEFAULT_PLAN = PLANS / "random"


def plan_for(robot: Robot, plan: Path | None) -> PosturePlan:
    """Read a plan that fits the robot, from a folder or by a shipped name; TULip's `random` if None."""
    if plan is None and robot.model_hash != load_robot().model_hash:
        raise InputError(
            f"{robot.path}: found no plan for this robot: the shipped one is TULip's. Draw one with "
            "`tulip plan random` or `tt.draw_plan` and give its name"
        )
    folder = DEFAULT_PLAN if plan is None else plan_folder(plan)
    if len(folder.parts) == 1 and not folder.exists():
        expected = choices(folder, PLAN_NAMES)
        raise InputError(f"{folder}: no such plan folder, and no shipped plan has this name; {expected}")
    return read_plan(folder, robot)


def check_measurable(robot: Robot) -> None:
    """Refuse a robot that no laboratory can measure, and warn of what it lacks."""
    check_scene(preset_rig("ideal", robot))
    warn_of_robot(robot)


def check_plan(robot: Robot, plan: PosturePlan, source: str) -> None:
    """Refuse a plan that would not identify the robot, or that no laboratory can measure."""
    check_fits(source, plan, robot)
    check_measurable(robot)
    identifiable_regressor(source, robot, plan)


def enough(where: str, postures: int, parameters: BaseParameters) -> None:
    """Refuse fewer data points than parameters."""
    if 2 * postures < (count := len(parameters.names)):
        raise InputError(f"{where}: found {postures} postures, too few for {count} base parameters")


def planned_parameters(robot: Robot, plan: PosturePlan) -> BaseParameters:
    """Derive the base parameters that a plan's postures can tell."""
    return base_parameters(robot, support=common_support(plan.support))


def identifiable_regressor(source: str, robot: Robot, plan: PosturePlan) -> np.ndarray:
    """Return the regressor (2m, p) of a plan that would identify the robot if all postures could be held."""
    parameters = planned_parameters(robot, plan)
    enough(source, len(plan), parameters)
    matrix = stacked_regressor(parameters, plan.joint_angles, plan.support)
    names = labels(np.arange(1, matrix.shape[1] + 1), parameters.names)
    blur = encoder_blur(parameters, plan.joint_angles, ENCODER_SD, plan.support)
    require_identifiable(matrix, names, source, blur)
    return matrix


def random_plan(
    robot: Robot, placements: int = 10, per_placement: int = 5, seed: int = 1, progress: Progress = silent
) -> PosturePlan:
    """Draw random feasible postures, `per_placement` on each placement of the feet."""
    at_least("placements", placements, 1)
    at_least("per_placement", per_placement, 1)
    at_least("seed", seed, 0)
    at_most("placements, per_placement", placements * per_placement, MOST_ROWS)
    enough("placements, per_placement", placements * per_placement, base_parameters(robot))
    check_measurable(robot)
    plate = nominal_plates(robot)[0]
    with progress("drawing postures", placements * per_placement, 0) as advance:
        return random_postures(robot, plate, placements, per_placement, seed, progress=advance)


def as_plan(robot: Robot, measured: Measurements) -> PosturePlan:
    """Measured postures as if they were planned; the swing foot is where the angles put it."""
    nominal = nominal_robot(robot, common_support(measured.support))
    pose = nominal.other_sole(measured.joint_angles, measured.support)
    return PosturePlan(
        joints=measured.joints,
        joint_angles=measured.joint_angles,
        posture=measured.posture,
        placement=measured.placement,
        support=measured.support,
        swing_pose=pose,
        robot={"model": robot.model_file.name, "sha256": robot.model_hash},
    )


def joined(plans: list[PosturePlan]) -> PosturePlan:
    """Plans one after the other, with the first one's robot and provenance; numbers stay."""
    names = ["joint_angles", "posture", "placement", "support", "swing_pose", "feed_forward"]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(plan, name) for plan in plans]) for name in names}
    torques = arrays.pop("feed_forward")
    held = all(plan.torques is None for plan in plans)
    return replace(plans[0], **arrays, torques=None if held else torques, motion=None)


def plan_hash(plan: PosturePlan | Trajectory) -> str:
    """Hash everything that a plan or its motion asks for, which is in its arrays, in hexadecimal."""
    digest = hashlib.sha256()
    for field in fields(plan):
        if isinstance(array := getattr(plan, field.name), np.ndarray):
            digest.update(f"{field.name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()
