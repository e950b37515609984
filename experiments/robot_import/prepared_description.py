"""The description (TOML) of a prepared robot, with ranges and margins for plans that are scaled to it."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np

from tulip_testbed.base.column import printable
from tulip_testbed.experiments.robot_import.feet import Stance
from tulip_testbed.experiments.robot_import.skeleton import Skeleton
from tulip_testbed.experiments.robot_import.standing_posture import Standing

# Of a leg's length, unless deg; chosen so that legs of ordinary humanoids reach most of it.
STEP, APART, TOGETHER, SINK = 0.15, 0.15, 0.05, 0.12
YAW, TORSO_YAW, TORSO_PITCH, TORSO_ROLL = 20.0, 15.0, (-5.0, 20.0), 10.0  # deg
STABILITY, SOLE = 0.2, 0.15  # of a sole's width
CELL = 0.009  # of the weight, as TULip's
ROOM = 0.01  # m, between the soles
FREE, MOST_FREE = 0.25, 40.0  # of the range of a joint that is not between the feet, either way; deg


def description(name: str, path: Path, skeleton: Skeleton, stance: Stance, planning: str = "") -> str:
    """Return the description of a robot as TOML.

    Args:
        path: of the published file. planning: see `planning_table`.
    """
    right, left = (skeleton.name(foot.link) for foot in stance.feet)
    return (
        f"# Prepared by `tulip robot` from {printable(path.name)}; everything here can be edited.\n"
        f"name = {json.dumps(name)}\n"
        'model = "robot.xml"         # the robot alone: links, hinges, motors, sole corners, keyframe stand\n'
        f"stance_foot = {json.dumps(right)}\n"
        f"swing_foot = {json.dumps(left)}\n\n{planning}"
    )


def planning_table(
    model: mujoco.MjModel, stance: Stance, standing: Standing, free: tuple[str, ...], weight: float
) -> str:
    """Return the [planning] table of a description.

    Args:
        model: the robot alone. free: joints that are not between the feet. weight: [N].
    """
    leg = standing.leg
    corners = stance.feet[0].corners
    width = float(np.ptp(corners[:, 1]))
    inner = float(corners[:, 1].max() - stance.feet[1].corners[:, 1].min())
    nearest = max(inner + ROOM, standing.spacing - TOGETHER * leg)
    farthest = max(standing.spacing + APART * leg, nearest + 0.5 * APART * leg)
    lines = [
        "[planning]                  # ranges from which postures are drawn, and the margins that they keep",
        f"swing_x = [{-STEP * leg:.3f}, {STEP * leg:.3f}]    # swing foot from the stance foot [m]",
        f"swing_y = [{nearest:.3f}, {farthest:.3f}]",
        f"swing_yaw_deg = [{-YAW:g}, {YAW:g}]",
        f"torso_yaw_deg = [{-TORSO_YAW:g}, {TORSO_YAW:g}]       # the free body",
        f"torso_pitch_deg = [{TORSO_PITCH[0]:g}, {TORSO_PITCH[1]:g}]",
        f"torso_roll_deg = [{-TORSO_ROLL:g}, {TORSO_ROLL:g}]",
        f"least_height = {standing.height - SINK * leg:.3f}        # of the free body over the soles [m]",
        f"stability_margin = {STABILITY * width:.4f}   # centre of mass inside the support polygon [m]",
        "foot_clearance = 0.0",
        f"sole_margin = {SOLE * width:.4f}        # each foot's CoP inside its sole [m]",
        f"least_cell_load = {CELL * weight:.2f}     # on each of the eight cells [N]",
    ]
    if free:
        lines += ["", "[planning.joints_deg]       # joints that are not between the feet"]
    for name in free:
        joint = model.joint(name)
        at = float(np.degrees(standing.qpos[joint.qposadr[0]]))
        low, high = np.degrees(joint.range)
        reach = min(FREE * (high - low), MOST_FREE)
        least, most = max(float(low), at - reach), min(float(high), at + reach)
        # Within the range, as written.
        within = f"[{np.ceil(10 * least + 0.1) / 10:.1f}, {np.floor(10 * most - 0.1) / 10:.1f}]"
        lines.append(f"{json.dumps(name)} = {within}")
    return "\n".join(lines) + "\n"
