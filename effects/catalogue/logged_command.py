"""The log holds a joint's commanded angle in place of its encoder's reading.

Such a log agrees with the command in all postures, up to rounding; a true reading does not, because a servo
holds its load with an error. The prediction restores the angle where the motor's encoder says that the
motor is. If motors were not recorded, it is where the nominal servo yields to the load of the nominal
robot: torque = stiffness (command - angle), stiffness = torque limit over the error at full torque. That
leaves out the torque of dry friction in the joint, which nobody knows, so that the explanation is often
judged insufficient. In both cases the joint turns beyond its motor by the wind-up that the robot's
description states.

Where the log differs from the command the fault is absent. The prediction then adds it, which shows how
much of it the experiment would see and explains nothing. Without commands in the measurements it changes
nothing. There is no size to estimate; the one choice is what was logged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.joint_loads import servo_stiffness
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.control import Controller

SOURCES = ("encoder", "command")
ROUNDING = 1e-5  # rad, of a log; servos err by a hundred times as much


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    if m.command is None or not values[0]:
        return m
    at = m.joints.index(target)
    angles, spread = m.joint_angles.copy(), m.joint_angles_sd.copy()
    angles[:, at], spread[:, at] = m.command[:, at], 0.0
    return replace(m, joint_angles=angles, joint_angles_sd=spread)


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    m, at = observed.measurements, observed.tree.joints.index(target)
    if m.command is None or not values[0]:
        return observed
    command, angles = m.command[:, at], observed.joint_angles.copy()
    # What yields beyond the encoder has no part in the servo's error. The load turns the joint its own way.
    torque, wind_up = (
        observed.torques[:, at],
        observed.nominal.robot.settings.get("drives", {}).get("wind_up"),
    )
    motor = command + torque / observed.servo_gain[at] if m.motor is None else m.motor[:, at]
    turned = motor
    if wind_up:
        full = servo_stiffness(observed.nominal.robot, {})[at] * Controller().error_at_full_torque
        turned = motor + wind_up * torque / full
    logged = (np.abs(m.joint_angles[:, at] - command) < ROUNDING).all()
    angles[:, at] = turned if logged else angles[:, at] + command - turned
    return observed.changed(joint_angles=angles)


EFFECT = Effect(
    name="logged-command",
    sentence="The log holds a joint's command in place of its encoder's reading.",
    parameters=(Parameter("source", "", grid=(1,), choices=SOURCES),),
    mechanism=Misreading(_apply, _undo),
    words="The log of the {target} joint holds its {0} in place of its encoder's reading.",
    targets=JOINTS,
)
