"""The laboratory as a `dm_env` environment for controllers and learning code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
from dm_control import composer, mjcf

from tulip_testbed.base.errors import InputError, listed, look_up, shortened
from tulip_testbed.measurements import lay_boards
from tulip_testbed.sim.composer.task import LaboratoryTask
from tulip_testbed.sim.control import remove_servos
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names, joint_ranges, sole_corners
from tulip_testbed.sim.scene import laboratory_scene, nominal_plates

ACTUATIONS = ("angles", "torques")
OPTIONS = ("enabled", "buffer_size", "aggregator", "delay", "update_interval", "corruptor")
BEYOND_RANGE = 0.03  # rad beyond a joint's range: measured angles are noisy and drives sag
LEVEL = 1e-3  # m: largest height of a sole corner over the ground when the robot is put down


def laboratory_environment(
    rig: Rig,
    joint_angles: np.ndarray,
    plate_poses: np.ndarray | None = None,
    *,
    actuation: str = "angles",
    control_timestep: float = 0.02,
    time_limit: float = 60.0,
    seed: int | None = None,
    reward: Callable[[mjcf.Physics], float] = lambda physics: 0.0,
    observable_options: Mapping[str, Mapping[str, Any]] | None = None,
) -> composer.Environment:
    """Make an environment in which the robot stands on its two plates.

    An episode begins with the robot at `joint_angles`, at rest and with free feet. It ends when the robot
    tips or after `time_limit`.

    Args:
        joint_angles: the posture in the order of the model's joints, as in a row of a plan, (n,) [rad].
        plate_poses: poses of the right and the left plate in the base frame, (2, 3) [m, m, rad]; None
            lays the boards under the soles.
        actuation: meaning of an action, (n,): "angles" are commands of the rig's PD servos [rad],
            "torques" are joint torques [Nm].
        control_timestep: time between actions [s].
        time_limit: length of an episode [s].
        seed: seed of the sensors' errors.
        reward: function of the physics after an action.
        observable_options: options of dm_control (`OPTIONS`) by the observable's name; delay and
            update_interval count physics steps.

    Raises:
        InputError: an argument has a wrong shape or value, the rig has wrench sensors, or a broken scene.
    """
    look_up("actuation", actuation, ACTUATIONS, "actuation")
    if rig.sensors.wrench is not None:
        raise InputError("rig: found wrench sensors, expected plates on cells: only cells are observed")
    nominal = rig.robot.model
    _check_times(control_timestep=control_timestep, time_limit=time_limit)
    angles = _checked(joint_angles, (len(joint_names(nominal)),), "joint_angles")
    _check_ranges(nominal, angles)
    soles = _soles(nominal, rig, angles)
    if plate_poses is None:
        size = nominal_plates(rig.robot)[0].size
        plate_poses = lay_boards(soles, size, rig.protocol.plate_gap)
    spec = laboratory_scene(rig, _checked(plate_poses, (2, 3), "plate_poses"))
    if actuation == "torques":
        remove_servos(spec)
    task = LaboratoryTask(rig, nominal, spec, angles, actuation, reward, control_timestep)
    _set_options(task, observable_options or {})
    return composer.Environment(
        task,
        time_limit=time_limit,
        random_state=seed,
        strip_singleton_obs_buffer_dim=True,
        # The MJCF is the same in all episodes; compiling it takes as long as 300 resets.
        recompile_mjcf_every_episode=False,
        # Otherwise averages over a buffer that is not full yet would include zeros.
        delayed_observation_padding=composer.ObservationPadding.INITIAL_VALUE,
        # Plain mj_step, as everywhere in the laboratory, so that contacts and forces belong to the step.
        legacy_step=False,
    )


def _check_times(**times: float) -> None:
    for name, seconds in times.items():
        if not isinstance(seconds, int | float | np.number) or not seconds > 0:
            raise InputError(f"{name}: found {seconds!r}, expected a time above 0 s")


def _check_ranges(nominal: mujoco.MjModel, angles: np.ndarray) -> None:
    """Refuse a posture outside of the joint ranges, for example one in degrees."""
    low, high = joint_ranges(nominal).T
    outside = (angles < low - BEYOND_RANGE) | (angles > high + BEYOND_RANGE)
    if outside.any():
        k = int(outside.argmax())
        raise InputError(
            f"joint_angles: found {angles[k]:g} for '{joint_names(nominal)[k]}', expected "
            f"[{low[k]:.3f}, {high[k]:.3f}] rad" + ("; degrees?" if abs(angles[k]) > np.pi else "")
        )


def _checked(values: np.ndarray, shape: tuple[int, ...], name: str) -> np.ndarray:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: found {shortened(repr(values))}, expected {shape} numbers") from None
    if array.shape != shape or not np.isfinite(array).all():
        found = f"shape {array.shape}" if array.shape != shape else "a number that is not finite"
        raise InputError(f"{name}: found {found}, expected {shape} finite numbers")
    return array


def _soles(nominal: mujoco.MjModel, rig: Rig, angles: np.ndarray) -> np.ndarray:
    """Return the sole corners of a posture with flat soles in the base frame, (2, 4, 2) [m]."""
    data = mujoco.MjData(nominal)
    for name, angle in zip(joint_names(nominal), angles, strict=True):
        data.joint(name).qpos = angle
    data.qpos[:7] = ClosedChain(nominal, rig.robot).base_pose(angles)
    mujoco.mj_kinematics(nominal, data)
    feet = [data.body(foot) for foot in rig.robot.feet]
    soles = np.array(
        [foot.xpos + sole_corners(nominal, foot.name) @ foot.xmat.reshape(3, 3).T for foot in feet]
    )
    if np.abs(soles[..., 2]).max() > LEVEL:
        heights = listed(np.round(1e3 * soles[1, :, 2], 1))
        raise InputError(
            f"joint_angles: found the corners of '{rig.robot.swing_foot}' at heights {heights} mm over the "
            "stance sole, expected both soles flat on one ground"
        )
    return soles[..., :2]


def _set_options(task: LaboratoryTask, options: Mapping[str, Mapping[str, Any]]) -> None:
    observables = [entity.observables.as_dict(False) for entity in (task.robot, *task.plates)]
    valid = list(dict.fromkeys(name for group in observables for name in group))
    for name, values in options.items():
        look_up("observable", name, valid, "observable_options")
        for option in values:
            look_up("option", option, OPTIONS, f"observable_options, '{name}'")
        for group in observables:
            if name in group:
                group[name].configure(**values)
