"""The task of the composer: the robot stands on its two plates."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.observation import observable
from dm_env import specs

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.composer.parts import Part, SceneParts, join, split_scene
from tulip_testbed.sim.control import torque_limit
from tulip_testbed.sim.dynamics.stand import hoist_damping
from tulip_testbed.sim.path import ClosedChain, tipped
from tulip_testbed.sim.plates import cell_names, tare
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_names, joint_ranges, load_spec
from tulip_testbed.sim.sensors import Sensors, cell_gains, corrupted
from tulip_testbed.sim.specs import compile_spec

TURN = 2 * np.pi


class RobotEntity(composer.Entity):
    """The robot; joints, actuators and motors are in the order of the nominal model's joints.

    Attributes:
        joints, actuators: elements of the MJCF model.
        motors: joint of each actuator; the robot's own joint where the drive is rigid.
        torso: body with the free joint.
        soles: sole corners of each foot.
        interval: physics steps between samples.
    """

    def _build(
        self, part: Part, robot: Robot, nominal: mujoco.MjModel, sensors: Sensors, interval: int
    ) -> None:
        self._root = part.root
        names = joint_names(nominal)
        drives = {nominal.joint(nominal.actuator_trnid[i, 0]).name: i for i in range(nominal.nu)}
        self.joints = [part.root.find("joint", name) for name in names]
        self.actuators = [part.root.find("actuator", nominal.actuator(drives[name]).name) for name in names]
        self.motors = [actuator.joint for actuator in self.actuators]
        self.torso = part.root.worldbody.body[0]
        self.soles = [[part.root.find("geom", f"{foot}_{c}") for c in CORNERS] for foot in robot.feet]
        ones = np.ones(len(names))
        self.joint_channel = Channel(ones, *sensors.encoder)
        self.motor_channel = Channel(ones, *sensors.motor)
        self.interval = interval

    def _build_observables(self) -> RobotObservables:
        return RobotObservables(self)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        return self._root

    def initialize_episode(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        self.joint_channel.draw(random_state)
        self.motor_channel.draw(random_state)


class RobotObservables(composer.Observables):
    """Observables of the robot; all but the encoders are true values and disabled."""

    @composer.observable
    def joint_encoders(self) -> observable.MJCFFeature:
        """Return the joint encoders, (n,) [rad]."""
        return _encoder(self._entity.joints, self._entity.joint_channel, self._entity.interval)

    @composer.observable
    def motor_encoders(self) -> observable.MJCFFeature:
        """Return the motor encoders divided by the gear ratio, (n,) [rad]."""
        return _encoder(self._entity.motors, self._entity.motor_channel, self._entity.interval)

    @composer.observable
    def centre_of_mass(self) -> observable.MJCFFeature:
        """Return the robot's true centre of mass in the world, (3,) [m]."""
        return observable.MJCFFeature("subtree_com", self._entity.torso)

    @composer.observable
    def sole_forces(self) -> observable.Generic:
        """Return the true forces of the boards on the stance and the swing foot in the world, (6,) [N]."""
        soles = self._entity.soles
        return observable.Generic(lambda physics: _contact_forces(physics, soles).ravel())


def _encoder(joints: list[mjcf.Element], channel: Channel, interval: int) -> observable.MJCFFeature:
    encoder = observable.MJCFFeature("qpos", joints, update_interval=interval, corruptor=channel)
    encoder.enabled = True
    return encoder


def _contact_forces(physics: mjcf.Physics, groups: list[list[mjcf.Element]]) -> np.ndarray:
    """Sum the contact forces on each group of geoms in the world, (groups, 3) [N]."""
    model, data = physics.model.ptr, physics.data.ptr
    group_of = {int(i): k for k, geoms in enumerate(groups) for i in physics.bind(geoms).element_id}
    forces, wrench = np.zeros((len(groups), 3)), np.zeros(6)
    for number, contact in enumerate(data.contact):
        for geom, sign in zip(contact.geom, (-1, 1), strict=True):
            if geom in group_of:
                mujoco.mj_contactForce(model, data, number, wrench)
                # The rows of a contact's frame are its axes; its force acts on the second geom.
                forces[group_of[geom]] += sign * contact.frame.reshape(3, 3).T @ wrench[:3]
    return forces


class ForcePlate(composer.Entity):
    """A force plate: a board on four load cells.

    Attributes:
        cells: sensor elements of the four cells in the order of `CORNERS`.
        tare: readings of the cells under the empty board, (4,) [N].
        interval: physics steps between samples.
    """

    def _build(self, part: Part, cells: list[str], tare: np.ndarray, channel: Channel, interval: int) -> None:
        self._root = part.root
        self.cells = [part.root.find("sensor", name) for name in cells]
        self.tare, self.channel, self.interval = tare, channel, interval

    def _build_observables(self) -> PlateObservables:
        return PlateObservables(self)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        return self._root

    def initialize_episode(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        self.channel.draw(random_state)


class PlateObservables(composer.Observables):
    """Observables of a plate; the true forces are disabled."""

    @composer.observable
    def cells(self) -> observable.Generic:
        """Return the tared cell forces in the order of `CORNERS`, (4,) [N]."""
        cells = observable.Generic(
            self._true_forces, update_interval=self._entity.interval, corruptor=self._entity.channel
        )
        cells.enabled = True
        return cells

    @composer.observable
    def true_cells(self) -> observable.Generic:
        """Return the tared cell forces without sensor errors, (4,) [N]."""
        return observable.Generic(self._true_forces)

    def _true_forces(self, physics: mjcf.Physics) -> np.ndarray:
        return np.asarray(physics.bind(self._entity.cells).sensordata) - self._entity.tare


class Channel:
    """Sensors of one kind, with the data-sheet figures of `sim.sensors.Sensors`.

    A class because the repeatability error is constant within an episode.

    Attributes:
        gain: true gain of every sensor, (n,).
        offset: repeatability error of this episode, (n,).
    """

    def __init__(self, gain: np.ndarray, repeatability: float, noise: float, resolution: float):
        self.gain = gain
        self.repeatability, self.noise, self.resolution = repeatability, noise, resolution
        self.offset = np.zeros_like(gain)

    def draw(self, random_state: np.random.RandomState) -> None:
        """Draw the repeatability error of an episode."""
        self.offset = self.repeatability * random_state.standard_normal(self.gain.shape)

    def __call__(self, truth: np.ndarray, random_state: np.random.RandomState) -> np.ndarray:
        """Return one reading of the true values, (n,)."""
        signal = self.gain * np.asarray(truth) + self.offset
        return corrupted(signal, self.noise, self.resolution, random_state)


class LaboratoryTask(composer.Task):
    """Stand on the plates: an episode begins at a posture and ends when the robot tips.

    Attributes:
        robot: the robot's entity. plates: the right and the left plate's entity.
    """

    def __init__(
        self,
        rig: Rig,
        nominal: mujoco.MjModel,
        spec: mujoco.MjSpec,
        joint_angles: np.ndarray,
        actuation: str,
        reward: Callable[[mjcf.Physics], float],
        control_timestep: float,
    ):
        """Assemble the entities of a scene.

        The arguments are those of `laboratory_environment`; `spec` is the scene, `nominal` the robot alone.
        """
        model = compile_spec(spec, str(rig.robot.path))
        torso = model.body(model.body_rootid[model.body(rig.robot.stance_foot).id]).name
        scene = split_scene(
            spec, model, {"robot": torso} | {f"{plate}_plate": f"{plate}_plate" for plate in PLATES}
        )
        interval = max(1, round(1 / (rig.sensors.sample_rate * model.opt.timestep)))
        self.robot = RobotEntity(scene.parts["robot"], rig.robot, nominal, rig.sensors, interval)
        self.plates = _plates(scene, rig, tare(model), interval)
        self._arena = composer.ModelWrapperEntity(scene.arena)
        for entity, part in zip((self.robot, *self.plates), scene.parts.values(), strict=True):
            frame = self._arena.attach(entity)
            frame.pos, frame.quat = part.position, part.quaternion
            if part.free:
                frame.add("freejoint")
        join(scene)
        self._torso = mjcf.get_frame_freejoint(self.robot.mjcf_model)
        self._angles, self._pose = joint_angles, ClosedChain(nominal, rig.robot).base_pose(joint_angles)
        self._actuation = actuation
        self._tilt_limit = rig.protocol.tilt_limit
        self._hoist_damping = hoist_damping(rig)
        self._bounds, self._reward = _bounds(rig.robot, nominal, actuation), reward
        try:
            self.control_timestep = control_timestep
        except ValueError as error:
            raise InputError(f"control_timestep: {error}") from None

    @property
    def root_entity(self) -> composer.Entity:
        return self._arena

    def after_compile(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        physics.bind(self._torso).damping += self._hoist_damping

    def initialize_episode(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        physics.bind(self._torso).qpos = self._pose
        physics.bind(self.robot.motors).qpos = self._angles
        physics.bind(self.robot.joints).qpos = self._angles

    def action_spec(self, physics: mjcf.Physics) -> specs.BoundedArray:
        """Return the specification of an action: angles [rad] or torques [Nm] in joint order, (n,).

        The bounds are the nominal robot's; a command outside of them is accepted.
        """
        names = "\t".join(joint.full_identifier for joint in self.robot.joints)
        low, high = self._bounds
        return specs.BoundedArray(low.shape, float, low, high, names)

    def before_step(
        self, physics: mjcf.Physics, action: np.ndarray, random_state: np.random.RandomState
    ) -> None:
        """Write the action to the actuators."""
        command = _command(action, len(self.robot.joints), self._actuation)
        # Written directly: after a write by binding, the next reading would compute the whole state again.
        physics.data.ctrl[physics.bind(self.robot.actuators).element_id] = command

    def get_reward(self, physics: mjcf.Physics) -> float:
        return self._reward(physics)

    def should_terminate_episode(self, physics: mjcf.Physics) -> bool:
        return tipped(np.asarray(physics.bind(self._torso).qpos), self._pose, self._tilt_limit)


def _command(action: np.ndarray, count: int, actuation: str) -> np.ndarray:
    try:
        command = np.asarray(action, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"action: found {shortened(repr(action))}, expected {count} numbers") from None
    if command.shape != (count,):
        raise InputError(f"action: found shape {command.shape}, expected ({count},)")
    square = command @ command  # the cheapest test first, since this runs at every action
    if not square < np.inf:
        raise InputError(f"action: found a number that is not finite: {shortened(command)}")
    if actuation == "angles" and square > TURN**2 and np.abs(command).max() > TURN:
        raise InputError(
            f"action: found an angle of {command[np.abs(command).argmax()]:g}, expected radians within a turn"
        )
    return command


def _plates(scene: SceneParts, rig: Rig, empty: np.ndarray, interval: int) -> tuple[ForcePlate, ...]:
    sensors = rig.sensors
    names, gains = np.array(cell_names()).reshape(2, 4), cell_gains(sensors).reshape(2, 4)
    return tuple(
        ForcePlate(
            scene.parts[f"{plate}_plate"],
            names[k].tolist(),
            empty.reshape(2, 4)[k],
            Channel(gains[k], *sensors.cell),
            interval,
        )
        for k, plate in enumerate(PLATES)
    )


def _bounds(robot: Robot, nominal: mujoco.MjModel, actuation: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest action, each (n,): joint ranges or torque limits."""
    if actuation == "angles":
        low, high = joint_ranges(nominal).clip(-np.pi, np.pi).T
        return low, high
    spec = load_spec(robot.model_file)
    limits = {actuator.target: torque_limit(spec, actuator) for actuator in spec.actuators}
    high = np.array([limits[name] for name in joint_names(nominal)])
    return -high, high
