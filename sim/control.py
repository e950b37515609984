"""Joint PD control with torque limits: the model's motors turned into position servos."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco


@dataclass(frozen=True)
class Controller:
    """Gains by two rules, so that every drive is used alike.

    Attributes:
        error_at_full_torque: joint error that asks for the whole torque limit [rad];
            kp = torque limit / this.
        derivative_time: kd / kp [s].
        command_sd: s.d. of the commanded angle about the planned one, per posture [rad].
    """

    error_at_full_torque: float = 0.02
    derivative_time: float = 0.02
    command_sd: float = 0.0005


def add_servos(spec: mujoco.MjSpec, controller: Controller) -> None:
    """Make every motor of `spec` a PD servo that saturates at the motor's torque limit."""
    for actuator in spec.actuators:
        limit = actuator.forcerange[1]
        kp = limit / controller.error_at_full_torque
        actuator.set_to_position(kp=kp, kv=kp * controller.derivative_time)
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE


def remove_servos(spec: mujoco.MjSpec) -> None:
    """Make every servo of `spec` a plain motor again: its control is a torque [Nm]."""
    for actuator in spec.actuators:
        actuator.set_to_motor()
