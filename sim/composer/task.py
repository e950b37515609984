"""The task of the composer: the robot stands on its two plates."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_env import specs

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.composer.entities import Channel, ForcePlate, RobotEntity
from tulip_testbed.sim.composer.parts import SceneParts, join, split_scene
from tulip_testbed.sim.control import torque_limit
from tulip_testbed.sim.dynamics.stand import hoist_damping
from tulip_testbed.sim.path import ClosedChain, tipped
from tulip_testbed.sim.plates import cell_names, tare
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_names, joint_ranges, load_spec
from tulip_testbed.sim.sensors import cell_gains
from tulip_testbed.sim.specs import compile_spec

TURN = 2 * np.pi


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
