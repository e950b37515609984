"""The plan folder: plan.json and postures.parquet (or .csv)."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from pydantic import BaseModel, ValidationError

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import new_folder, sha256, write_text
from tulip_testbed.base.table_files import (
    TableFile,
    read_json,
    software,
    write_json,
    write_parquet,
    write_table,
)
from tulip_testbed.base.validation_message import validation_message
from tulip_testbed.measurements.bounds import MOST_ANGLE, MOST_LENGTH, Version
from tulip_testbed.measurements.checked_table import checked_table
from tulip_testbed.measurements.contract import SUPPORTS
from tulip_testbed.measurements.data import PosturePlan, base_foot, wrong_arrays
from tulip_testbed.measurements.folder_kind import check_kind
from tulip_testbed.measurements.motion_table import MOST_SAMPLES, MOTION, SEGMENT, check_segments
from tulip_testbed.measurements.trajectory import RATE, Trajectory
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.robot import Robot, joint_names

UNEVEN = 0.01  # of the time between samples
MOST_SWING = 0.01  # m or rad, between the swing foot as planned and by the joint angles
MOST_TORQUE = MOST_NUMBER = 1e5  # N m, of a drive; of any array


class PlanRobot(BaseModel):
    model: str
    sha256: str


class PlanManifest(BaseModel):
    """Content of plan.json."""

    format: Literal["tulip-plan"]
    version: Version
    robot: PlanRobot
    made: dict[str, Any]
    software: dict[str, str] | None
    tables: dict[str, str]


def write_plan(folder: Path, plan: PosturePlan, beside: Mapping[str, str] | None = None) -> None:
    """Write a plan folder, which appears whole or not at all, with further texts by their files."""
    columns = {"posture": plan.posture, "placement": plan.placement, "support": plan.support}
    columns |= _of_joints(plan, plan.joints)
    columns |= {f"swing.{axis}": plan.swing_pose[:, k] for k, axis in enumerate(("x", "y", "yaw"))}
    with new_folder(folder) as working:
        paths = list(write_table(working, "postures", columns).values())
        if plan.motion is not None:
            motion = {name: getattr(plan.motion, name) for name in ("time", SEGMENT, "placement", "support")}
            paths.append(write_parquet(working, MOTION, motion | _of_joints(plan.motion, plan.joints)))
        for name, text in (beside or {}).items():
            write_text(working / name, text)
        write_json(
            working / "plan.json",
            {
                "format": "tulip-plan",
                "version": 1,
                "robot": plan.robot,
                "made": plan.made,
                "software": software(),
                "tables": {path.name: sha256(path) for path in paths},
            },
        )


def read_plan(folder: Path, robot: Robot) -> PosturePlan:
    folder = Path(folder)
    check_kind(folder, "plan")
    where = folder / "plan.json"
    try:
        manifest = PlanManifest.model_validate(read_json(where))
    except ValidationError as error:
        raise InputError(f"{where}: {validation_message(error)}") from None
    check_model(where, manifest.robot.model, manifest.robot.sha256, robot)
    table = checked_table(folder, "postures", manifest.tables, advice="")
    joints = joint_names(robot.model)
    swing = [table.numbers(f"swing.{axis}", False, -MOST_LENGTH, MOST_LENGTH) for axis in ("x", "y")]
    swing.append(table.numbers("swing.yaw", False, -MOST_ANGLE, MOST_ANGLE))
    plan = PosturePlan(
        joints=joints,
        posture=table.integers("posture"),
        placement=table.integers("placement"),
        support=table.texts("support", SUPPORTS),
        swing_pose=np.column_stack(swing),
        robot=manifest.robot.model_dump(),
        made=manifest.made,
        **_read_joints(table, joints),
    )
    check_postures(table.path, plan, robot)
    if not any(name.startswith(f"{MOTION}.") for name in manifest.tables):
        return plan
    table = checked_table(folder, MOTION, manifest.tables, MOST_SAMPLES, "")
    motion = Trajectory(
        time=table.numbers("time"),
        segment=table.integers(SEGMENT),
        placement=table.integers("placement"),
        support=table.texts("support", SUPPORTS),
        **_read_joints(table, joints),
    )
    moving = replace(plan, motion=motion)
    check_motion(table.path, moving, robot)
    return moving


def _of_joints(rows: PosturePlan | Trajectory, joints: tuple[str, ...]) -> dict[str, np.ndarray]:
    tables = {"q": rows.joint_angles} | ({} if rows.torques is None else {"torque": rows.torques})
    return {
        f"{prefix}.{joint}": values[:, k]
        for prefix, values in tables.items()
        for k, joint in enumerate(joints)
    }


def _read_joints(table: TableFile, joints: tuple[str, ...]) -> dict[str, Any]:
    fed = any(table.has(f"torque.{joint}") for joint in joints)
    return {
        "joint_angles": table.matrix("q", joints, False, -MOST_ANGLE, MOST_ANGLE),
        "torques": table.matrix("torque", joints, False, -MOST_TORQUE, MOST_TORQUE) if fed else None,
    }


def check_motion(path: Path | str, plan: PosturePlan, robot: Robot) -> None:
    """Refuse a motion that no laboratory could follow.

    A segment is one motion at 100 Hz within the joints' ranges, on a placement and support of the plan.
    """
    motion = plan.motion
    assert motion is not None
    rows, joints = np.shape(motion.time), (*np.shape(motion.time), len(plan.joints))
    shapes = dict.fromkeys(("time", "segment", "placement", "support"), rows)
    if wrong := wrong_arrays(motion, shapes | dict.fromkeys(("joint_angles", "torques"), joints)):
        raise InputError(f"{path}: {wrong}")
    check_segments(path, motion.time, motion.segment, motion.placement, motion.support)
    check_limits(path, plan.joints, motion.joint_angles, robot.model)
    stances = set(zip(plan.placement.tolist(), plan.support.tolist(), strict=True))
    for rows in motion.segments:
        stance = int(motion.placement[rows.start]), str(motion.support[rows.start])
        if stance not in stances:
            raise InputError(
                f"{path}: row {rows.start + 1}: found placement {stance[0]} with support '{stance[1]}', "
                "expected those of a posture of the plan"
            )
        steps = np.diff(motion.time[rows])
        if not len(steps) or np.abs(steps * RATE - 1).max() > UNEVEN:
            seen = f"from {steps.min():.4g} to {steps.max():.4g} s" if len(steps) else "none"
            raise InputError(
                f"{path}: column 'time', segment {motion.segment[rows.start]}: found steps {seen}, "
                f"expected one each {1 / RATE:g} s in a segment"
            )


def check_model(where: Path | str, made_with: str | None, expected: str | None, robot: Robot) -> None:
    """Refuse data of another nominal model than the robot's, by file name and sha256; None: not given."""
    if expected is not None and (found := robot.model_hash) != expected:
        raise InputError(
            f"{where}: made for another robot than {robot.name}: hash mismatch of the robot's model: "
            f"{robot.model_file.name} has sha256 {found[:12]}..., expected {shortened(expected[:12])}... "
            f"({shortened(made_with)}); give the robot that it was made for as `robot`"
        )


def check_fits(where: str, plan: PosturePlan, robot: Robot) -> None:
    """Refuse a plan in memory that a robot's plan folder could not hold."""
    check_model(where, plan.robot.get("model"), plan.robot.get("sha256"), robot)
    if not isinstance(plan.joints, tuple):
        raise InputError(f"{where}: joints: found {type(plan.joints).__name__}, expected a tuple of names")
    if plan.joints != (expected := joint_names(robot.model)):
        raise InputError(f"{where}: found joints {listed(plan.joints)}, expected {listed(expected)}")
    if wrong := plan.wrong_shape() or ("" if len(plan) else "found no rows, expected one per posture"):
        raise InputError(f"{where}: {wrong}")
    if (bad := ~np.isin(plan.support, SUPPORTS)).any():
        row = int(bad.argmax())
        found = shortened(repr(str(plan.support[row])))
        raise InputError(f"{where}: support, row {row + 1}: found {found}, expected {listed(SUPPORTS)}")
    arrays = {"joint_angles": plan.joint_angles, "swing_pose": plan.swing_pose, "torques": plan.feed_forward}
    for name, values in arrays.items():
        if (bad := ~(np.abs(values) <= MOST_NUMBER).all(axis=1)).any():
            row = bad.argmax() + 1
            raise InputError(f"{where}: row {row}: found {name} beyond {MOST_NUMBER:g} or not finite")
    check_postures(where, plan, robot)
    if plan.motion is not None:
        check_motion(f"{where}: motion", plan, robot)


def check_postures(path: Path | str, plan: PosturePlan, robot: Robot) -> None:
    """Refuse postures out of range, two base frames in a placement, a swing foot elsewhere, and numbers of
    different postures.
    """
    check_limits(path, plan.joints, plan.joint_angles, robot.model)
    check_support(path, plan)
    check_swing(path, plan, robot)
    check_repeats(path, plan)


def check_support(path: Path | str, plan: PosturePlan) -> None:
    """Refuse a placement in which some postures stand on the left foot alone and others do not."""
    _, first, place = np.unique(plan.placement, return_index=True, return_inverse=True)
    foot, same = base_foot(plan.support), first[place]
    if (other := foot != foot[same]).any():
        row = int(other.argmax())
        raise InputError(
            f"{path}: column 'support', row {row + 1}: found '{plan.support[row]}' after "
            f"'{plan.support[same[row]]}' in placement {plan.placement[row]}, expected 'left' in all of its "
            "postures or in none (poses are in the left foot's frame then)"
        )


def check_swing(path: Path | str, plan: PosturePlan, robot: Robot) -> None:
    """Refuse a swing foot that is not where the joint angles put it, in double support."""
    chain = ClosedChain(robot.model, robot)
    for row in np.flatnonzero(plan.support == SUPPORTS[0]):
        there = chain.swing_pose(plan.joint_angles[row])
        off = plan.swing_pose[row] - there
        off[2] = np.arctan2(np.sin(off[2]), np.cos(off[2]))
        if np.abs(off).max() > MOST_SWING:
            found, expected = (listed(f"{x:.4g}" for x in pose) for pose in (plan.swing_pose[row], there))
            raise InputError(
                f"{path}: columns 'swing.*', row {row + 1}: found {found} (m, m, rad), expected {expected} "
                f"within {MOST_SWING:g}, where the joint angles put the foot"
            )


def check_repeats(path: Path | str, plan: PosturePlan) -> None:
    """Refuse rows that share a number but not the posture."""
    _, first, number = np.unique(plan.posture, return_index=True, return_inverse=True)
    same = first[number]
    other = (
        (plan.joint_angles != plan.joint_angles[same]).any(axis=1)
        | (plan.support != plan.support[same])
        | (plan.swing_pose != plan.swing_pose[same]).any(axis=1)
        | (plan.feed_forward != plan.feed_forward[same]).any(axis=1)
    )
    if other.any():
        row = int(other.argmax())
        raise InputError(
            f"{path}: column 'posture', row {row + 1}: found number {plan.posture[row]} again, but not the "
            f"angles, support, swing foot and torques of row {same[row] + 1}; expected one number per posture"
        )


def check_limits(
    path: Path | str, joints: tuple[str, ...], joint_angles: np.ndarray, model: mujoco.MjModel
) -> None:
    """Refuse angles, (m, n_joints) [rad], that leave a joint's range by more than a rounding error."""
    for k, joint in enumerate(joints):
        low, high = model.joint(joint).range
        angles = joint_angles[:, k]
        outside = (angles < low - 1e-9) | (angles > high + 1e-9)
        if model.joint(joint).limited[0] and outside.any():
            row = int(outside.argmax())
            raise InputError(
                f"{path}: column 'q.{joint}', row {row + 1}: found {angles[row]:.5g} rad, "
                f"expected within [{low:.4f}, {high:.4f}]"
            )
