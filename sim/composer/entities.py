"""Entities of dm_control: the robot and the force plates, with their sensors."""

from __future__ import annotations

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.observation import observable

from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.composer.parts import Part
from tulip_testbed.sim.robot import Robot, joint_names
from tulip_testbed.sim.sensors import Sensors, corrupted


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
