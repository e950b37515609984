"""Joint PD control with torque limits: replace the model's motors by position servos."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.sim.robot import Robot, joint_names


@dataclass(frozen=True)
class Controller:
    """Gains of all servos by two rules, so that every drive is used alike.

    Attributes:
        error_at_full_torque: joint error at which the servo reaches its torque limit [rad];
            kp = torque limit / error_at_full_torque.
        derivative_time: kd / kp [s].
        command_sd: s.d. of the commanded angle about the planned one, per posture [rad].
    """

    error_at_full_torque: float = 0.02
    derivative_time: float = 0.02
    command_sd: float = 0.0005


def add_servos(spec: mujoco.MjSpec, controller: Controller) -> None:
    """Make every actuator of `spec` a PD servo on its joint's angle that saturates at its torque limit."""
    for actuator in spec.actuators:
        limit = torque_limit(spec, actuator)
        kp = limit / controller.error_at_full_torque
        actuator.set_to_position(kp=kp, kv=kp * controller.derivative_time)
        actuator.gear = [1, 0, 0, 0, 0, 0]
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-limit, limit]
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE


def torque_limit(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator) -> float:
    """Return the largest torque of an actuator on its joint [Nm], the least of the given limits."""
    if torques := _torques(spec, actuator):
        return min(torques)
    raise InputError(
        f"model '{spec.modelname}': actuator '{actuator.name}': found no torque limit, "
        "expected forcerange, a motor's ctrlrange, or the joint's actuatorfrcrange"
    )


def _torques(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator) -> list[float]:
    """List the limits of an actuator's torque on its joint, in both directions alike [Nm]."""
    gear, joint = abs(actuator.gear[0]), spec.joint(actuator.target)
    plain_motor = (
        actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
        and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
        and actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE
    )
    limits = [
        ("forcerange", actuator.forcelimited, gear, actuator.forcerange),
        ("joint's actuatorfrcrange", joint.actfrclimited, 1.0, joint.actfrcrange),
    ]
    if plain_motor:
        limits.append(("ctrlrange", actuator.ctrllimited, gear * actuator.gainprm[0], actuator.ctrlrange))
    where = f"model '{spec.modelname}': actuator '{actuator.name}'"
    torques = []
    for name, limited, scale, (low, high) in limits:
        if limited == mujoco.mjtLimited.mjLIMITED_FALSE or (low, high) == (0.0, 0.0):
            continue
        if not low < 0 < high:
            raise InputError(f"{where}: found {name} [{low:g}, {high:g}], expected low < 0 < high")
        if scale > 0:
            torques.append(scale * min(-low, high))
    return torques


def torque_limits(robot: Robot) -> np.ndarray:
    """Return the largest torque of the motors on every joint, (n_joints,) [Nm]; infinite: none is given."""
    torques = joint_torques(robot.spec)
    return np.array([torques.get(name, np.inf) for name in joint_names(robot.model)])


def joint_torques(spec: mujoco.MjSpec) -> dict[str, float]:
    """Return the largest torque on every hinge whose motors have a limit, by joint [Nm]."""
    limits: dict[str, float] = {}
    for actuator in spec.actuators:
        joint = spec.joint(actuator.target) if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT else None
        if joint is None or joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            continue
        if torques := _torques(spec, actuator):
            limits[joint.name] = min([limits.get(joint.name, np.inf), *torques])
    return limits
