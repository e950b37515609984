"""Laboratories with wrench sensors, and what their readings are in the base frame by MuJoCo alone."""

import dataclasses
from typing import Any

import mujoco
import numpy as np

import tulip_testbed as tt
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

NAMES = ("foot-ft", "plate-ft", "plate-cop", "sole-ft", "sole-3axis")
WHOLE = ("foot-ft", "plate-ft", "sole-ft")  # of six axes
GRAVITY = 9.81
TILTED = {  # m, rad: mountings
    "foot-ft": (0.01, -0.02, 0.03, 0.2, -0.3, 0.4),
    "plate-ft": (0.0,) * 6,
    "sole-ft": (0.01, -0.02, 0.03, 0.0, 0.0, 0.4),
}


def changed_rig(robot: tt.Robot, name: str, exact: bool = True, **changes: Any) -> Rig:
    """Return a preset's laboratory with changed wrench sensors, in which nothing is measured twice.

    Args:
        exact: encoders and records are exact, and wrench sensors err by their zeros alone.
    """
    rig = preset_rig(name, robot)
    wrench: Any = PRESETS[name].wrench
    base = PRESETS["ideal"] if exact else rig.sensors
    wrench = dataclasses.replace(wrench.exact if exact else wrench, **changes)
    protocol = dataclasses.replace(rig.protocol, repeats=0)
    return dataclasses.replace(rig, sensors=dataclasses.replace(base, wrench=wrench), protocol=protocol)


def laboratory(robot: tt.Robot, name: str) -> tt.Laboratory:
    return tt.Laboratory(robot, name, nominal=changed_rig(robot, name))


def by_ideal_cells(robot: tt.Robot, plan: tt.PosturePlan) -> Any:
    rig = preset_rig("ideal", robot)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    return tt.Laboratory(robot, "ideal", nominal=rig).run(plan, 3, "statics")


def statics(rig: Rig, plan: tt.PosturePlan, runs: int = 1) -> list[Any]:
    return list(run_statics(solve_plan(rig, plan), np.random.SeedSequence(7).spawn(runs)))


def heavy_foot(spec: mujoco.MjSpec) -> None:
    """Make the left foot 0.3 kg heavier and move its centre of mass."""
    foot = spec.body("left_foot")
    foot.mass, foot.ipos = foot.mass + 0.3, [0.05, 0.01, -0.04]


def feet_in_base(robot: tt.Robot, measured: Any) -> np.ndarray:
    """Return the feet's frames by row and side from MuJoCo's kinematics, (m, 2, 4, 4)."""
    data, chain = mujoco.MjData(robot.model), ClosedChain(robot.model, robot)
    frames = np.tile(np.eye(4), (len(measured), 2, 1, 1))
    for row, angles in enumerate(measured.joint_angles):
        data.qpos[:7] = chain.base_pose(angles, int(measured.support[row] == "left"))
        data.qpos[7:] = angles
        mujoco.mj_kinematics(robot.model, data)
        for side, foot in enumerate(robot.feet):
            frames[row, side, :3, :3] = data.body(foot).xmat.reshape(3, 3)
            frames[row, side, :3, 3] = data.body(foot).xpos
    return frames


def sensors_in_base(robot: tt.Robot, measured: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation (m, 2, 3, 3) and origin (m, 2, 3) of the sensors' frames in the base frame.

    On the ground by the recorded pose of the plate, its top at height zero; in the foot by MuJoCo.
    """
    if measured.contacts.mount == "foot":
        frames = feet_in_base(robot, measured)
        turn = frames[..., :3, :3]
        return turn, frames[..., :3, 3] + np.einsum("mpab,pb->mpa", turn, measured.contacts.pose[:, :3])
    x, y, yaw = np.moveaxis(measured.plate_poses, -1, 0)
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows = [[np.cos(yaw), -np.sin(yaw), zero], [np.sin(yaw), np.cos(yaw), zero], [zero, zero, one]]
    return np.moveaxis(np.array(rows), (0, 1), (2, 3)), np.stack([x, y, zero], axis=-1)


def ground_wrenches(robot: tt.Robot, run: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return forces and moments of the ground about the base frame's origin, (m, 2, 3) twice [N, Nm].

    Zeros and what hangs below the sensor are taken off. Channels that are not read are zero.
    """
    measured = run.measurements
    turn, origin = sensors_in_base(robot, measured)
    wrench = np.zeros((len(measured), 2, 6))
    kept = [WRENCH.index(channel) for channel in measured.contacts.channels]
    wrench[..., kept] = np.nan_to_num(measured.wrenches - run.truth.zeros)  # nan: in the air
    force = np.einsum("mpab,mpb->mpa", turn, wrench[..., :3])
    moment = np.einsum("mpab,mpb->mpa", turn, wrench[..., 3:]) + np.cross(origin, force)
    if measured.contacts.below.any():
        feet = feet_in_base(robot, measured)
        mass, center = measured.contacts.below[:, 0], measured.contacts.below[:, 1:]
        weight = np.multiply.outer(-mass * GRAVITY, [0.0, 0.0, 1.0])
        place = feet[..., :3, 3] + np.einsum("mpab,pb->mpa", feet[..., :3, :3], center)
        force, moment = force - weight, moment - np.cross(place, np.broadcast_to(weight, place.shape))
    return force, moment
