"""Provide the laboratory as a `dm_env` environment for controllers and learning code.

Importing this module sets MUJOCO_GL to "disable" unless it is set; dm_control warns without a display.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

os.environ.setdefault("MUJOCO_GL", "disable")

import dm_env
import mujoco
import numpy as np
from dm_control.composer.observation import Updater, observable
from dm_control.mujoco import Physics, wrapper
from dm_env import specs

from tulip_testbed.base.errors import InputError, listed, look_up, shortened
from tulip_testbed.measurements import lay_boards
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.dynamics.stand import hoist_damping
from tulip_testbed.sim.path import ClosedChain, tipped
from tulip_testbed.sim.plates import cell_addresses, tare
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names, joint_ranges, sole_corners
from tulip_testbed.sim.scene import laboratory_scene, nominal_plates
from tulip_testbed.sim.sensors import cell_gains, corrupted
from tulip_testbed.sim.specs import compile_spec

ACTUATIONS = ("angles", "torques")
OPTIONS = ("enabled", "buffer_size", "aggregator", "delay", "update_interval", "corruptor")
BEYOND_RANGE = 0.03  # rad beyond a joint's range: measured angles are noisy and drives sag
LEVEL = 1e-3  # m: largest height of a sole corner over the ground when the robot is put down
TURN = 2 * np.pi


def laboratory_environment(
    rig: Rig,
    joint_angles: np.ndarray,
    plate_poses: np.ndarray | None = None,
    *,
    actuation: str = "angles",
    control_timestep: float = 0.02,
    time_limit: float = 60.0,
    seed: int | None = None,
    reward: Callable[[Physics], float] = lambda physics: 0.0,
    begin: Callable[[Physics], None] = lambda physics: None,
    observable_options: Mapping[str, Mapping[str, Any]] | None = None,
) -> LaboratoryEnvironment:
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
        begin: changes the state in which an episode begins.
        observable_options: options of dm_control (`OPTIONS`) by the observable's name; delay and
            update_interval count physics steps.

    Raises:
        InputError: an argument has a wrong shape or value, the rig has wrench sensors, or a broken scene.
    """
    look_up("actuation", actuation, ACTUATIONS, "actuation")
    if rig.sensors.wrench is not None:
        raise InputError("rig: found wrench sensors, expected plates on cells: only cells are observed")
    nominal = rig.robot.model
    for name, seconds in (("control_timestep", control_timestep), ("time_limit", time_limit)):
        if not isinstance(seconds, int | float | np.number) or not seconds > 0:
            raise InputError(f"{name}: found {seconds!r}, expected a time above 0 s")
    angles = _checked(joint_angles, (len(joint_names(nominal)),), "joint_angles")
    _check_ranges(nominal, angles)
    soles = _soles(nominal, rig, angles)
    if plate_poses is None:
        plate_poses = lay_boards(soles, nominal_plates(rig.robot)[0].size, rig.protocol.plate_gap)
    spec = laboratory_scene(rig, _checked(plate_poses, (2, 3), "plate_poses"))
    if actuation == "torques":
        for actuator in spec.actuators:
            actuator.set_to_motor()
    model = compile_spec(spec, str(rig.robot.path))
    steps = control_timestep / model.opt.timestep
    if not abs(steps - round(steps)) < 1e-8:
        found = f"control_timestep: found {control_timestep:g} s"
        raise InputError(f"{found}, expected a multiple of the physics' {model.opt.timestep:g} s")
    environment = LaboratoryEnvironment(rig, model, angles, actuation, round(steps), time_limit, seed)
    environment.reward, environment.begin = reward, begin
    environment.configure(observable_options or {})
    return environment


class LaboratoryEnvironment(dm_env.Environment):
    """The robot on its plates; what it offers is documented at `laboratory_environment`.

    Attributes:
        physics: dm_control's access to model and state.
    """

    reward: Callable[[Physics], float]
    begin: Callable[[Physics], None]

    def __init__(
        self,
        rig: Rig,
        model: mujoco.MjModel,
        angles: np.ndarray,
        actuation: str,
        steps: int,
        time_limit: float,
        seed: int | None,
    ):
        nominal = rig.robot.model
        self.names = joint_names(nominal)
        drives = {nominal.joint(nominal.actuator_trnid[i, 0]).name: i for i in range(nominal.nu)}
        self._actuators = np.array(
            [model.actuator(nominal.actuator(drives[name]).name).id for name in self.names]
        )
        self._joints = np.array([model.joint(name).qposadr[0] for name in self.names])
        # The joint of each actuator: the robot's own where the drive is rigid.
        self._motors = model.jnt_qposadr[model.actuator_trnid[self._actuators, 0]]
        self._torso = int(model.body_rootid[model.body(rig.robot.stance_foot).id])
        free = int(model.body_jntadr[self._torso])
        self._free = model.jnt_qposadr[free] + np.arange(7)
        empty = tare(model)
        model.dof_damping[model.jnt_dofadr[free] + np.arange(6)] += hoist_damping(rig)
        self.physics = Physics.from_model(wrapper.MjModel(model))
        self.physics.legacy_step = False  # plain mj_step, as everywhere in the laboratory
        self._angles, self._pose = angles, ClosedChain(nominal, rig.robot).base_pose(angles)
        self._actuation, self._steps, self._time_limit = actuation, steps, time_limit
        self._tilt_limit = rig.protocol.tilt_limit
        if actuation == "angles":
            self._bounds = joint_ranges(nominal).clip(-np.pi, np.pi).T
        else:
            self._bounds = np.array([[-1.0], [1.0]]) * torque_limits(rig.robot)
        self._random, self._over = np.random.RandomState(seed), True
        self._observables = self._observed(rig, model, empty)

    def configure(self, options: Mapping[str, Mapping[str, Any]]) -> None:
        """Set dm_control's options of observables by name, those of both plates together."""
        valid = list(dict.fromkeys(path.partition("/")[2] for path in self._observables))
        for name, values in options.items():
            look_up("observable", name, valid, "observable_options")
            for option in values:
                look_up("option", option, OPTIONS, f"observable_options, '{name}'")
            for path, one in self._observables.items():
                if path.endswith(f"/{name}"):
                    one.configure(**values)
        # Averages over a buffer that is not full yet would include zeros without the initial value.
        self._updater = Updater(self._observables, self._steps, True, True)
        self._updater.reset(self.physics, self._random)

    def reset(self) -> dm_env.TimeStep:
        self._over = False
        with self.physics.reset_context():
            qpos = self.physics.data.qpos
            qpos[self._free], qpos[self._motors], qpos[self._joints] = self._pose, self._angles, self._angles
            for channel in self._channels:
                channel.draw(self._random)
            self.begin(self.physics)
        self._updater.reset(self.physics, self._random)
        return dm_env.restart(self._updater.get_observation())

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        if self._over:
            return self.reset()
        self.physics.data.ctrl[self._actuators] = self._command(action)
        self._updater.prepare_for_next_control_step()
        for _ in range(self._steps):
            self.physics.step()
            self._updater.update()
        reward, observed = self.reward(self.physics), self._updater.get_observation()
        pose = self.physics.data.qpos[self._free]
        self._over = tipped(pose, self._pose, self._tilt_limit) or self.physics.time() >= self._time_limit
        kind = dm_env.StepType.LAST if self._over else dm_env.StepType.MID
        return dm_env.TimeStep(kind, reward, 1.0, observed)

    def observation_spec(self) -> Any:
        return self._updater.observation_spec()

    def action_spec(self) -> Any:
        """Return the specification of an action: angles [rad] or torques [Nm] in joint order, (n,).

        The bounds are the nominal robot's; a command outside of them is accepted.
        """
        low, high = self._bounds
        return specs.BoundedArray(low.shape, float, low, high, "\t".join(self.names))

    def control_timestep(self) -> float:
        """Return the time between actions [s]."""
        return self._steps * self.physics.timestep()

    def _observed(
        self, rig: Rig, model: mujoco.MjModel, empty: np.ndarray
    ) -> dict[str, observable.Observable]:
        sensors, ones = rig.sensors, np.ones(len(self.names))
        interval = max(1, round(1 / (sensors.sample_rate * model.opt.timestep)))
        found: dict[str, observable.Observable] = {}
        self._channels = []

        def read(name: str, true: Callable[[Physics], np.ndarray], channel: Channel) -> None:
            found[name] = observable.Generic(true, update_interval=interval, corruptor=channel)
            found[name].enabled = True
            self._channels.append(channel)

        read("robot/joint_encoders", lambda p: p.data.qpos[self._joints], Channel(ones, *sensors.encoder))
        read("robot/motor_encoders", lambda p: p.data.qpos[self._motors], Channel(ones, *sensors.motor))
        found["robot/centre_of_mass"] = observable.Generic(lambda p: p.data.subtree_com[self._torso].copy())
        soles = [[model.geom(f"{foot}_{c}").id for c in CORNERS] for foot in rig.robot.feet]
        group_of = {geom: k for k, geoms in enumerate(soles) for geom in geoms}
        found["robot/sole_forces"] = observable.Generic(partial(_contact_forces, group_of))
        of_cells = (cell_addresses(model), empty, cell_gains(sensors))
        parts = zip(PLATES, *(values.reshape(2, 4) for values in of_cells), strict=True)
        for plate, addresses, own, gains in parts:

            def true(p: Physics, at: np.ndarray = addresses, own: np.ndarray = own) -> np.ndarray:
                return p.data.sensordata[at] - own

            read(f"{plate}_plate/cells", true, Channel(gains, *sensors.cell))
            found[f"{plate}_plate/true_cells"] = observable.Generic(true)
        return found

    def _command(self, action: np.ndarray) -> np.ndarray:
        command = _checked(action, (len(self.names),), "action")
        if self._actuation == "angles" and np.abs(command).max() > TURN:
            far = command[np.abs(command).argmax()]
            raise InputError(f"action: found an angle of {far:g}, expected radians within a turn")
        return command


class Channel:
    """Sensors of one kind, whose repeatability error is constant within an episode.

    Attributes:
        gain: true gain of every sensor, (n,).
        offset: repeatability error of this episode, (n,).
    """

    def __init__(self, gain: np.ndarray, repeatability: float, noise: float, resolution: float):
        self.gain, self.offset = gain, np.zeros_like(gain)
        self.repeatability, self.noise, self.resolution = repeatability, noise, resolution

    def draw(self, random_state: np.random.RandomState) -> None:
        self.offset = self.repeatability * random_state.standard_normal(self.gain.shape)

    def __call__(self, truth: np.ndarray, random_state: np.random.RandomState) -> np.ndarray:
        """Return one reading of the true values, (n,)."""
        return corrupted(self.gain * truth + self.offset, self.noise, self.resolution, random_state)


def _contact_forces(group_of: Mapping[int, int], physics: Physics) -> np.ndarray:
    """Sum the contact forces on the geoms of either sole in the world, (6,) [N]."""
    model, data = physics.model.ptr, physics.data.ptr
    forces, wrench = np.zeros((2, 3)), np.zeros(6)
    for number, contact in enumerate(data.contact):
        for geom, sign in zip(contact.geom, (-1, 1), strict=True):
            if geom in group_of:
                mujoco.mj_contactForce(model, data, number, wrench)
                # The rows of a contact's frame are its axes; its force acts on the second geom.
                forces[group_of[geom]] += sign * contact.frame.reshape(3, 3).T @ wrench[:3]
    return forces.ravel()


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
