"""The log holds a joint's commanded angle in place of its encoder's reading.

Such a log agrees with the command in all postures, up to rounding, and nothing else is taken for one: a servo
holds its load with an error that encoders see. The prediction restores the angle where the motor's encoder
says that the motor is. If motors were not recorded, it is where the nominal servo yields to the load of the
nominal robot: torque = stiffness (command - angle), stiffness = torque limit over the error at full torque.
That leaves out the torque of dry friction in the joint, which nobody knows, so that the explanation is often
judged insufficient. In both cases the joint turns beyond its motor by the wind-up that the robot's
description states. Without commands in the measurements nothing is removed.

There is no size to estimate; the one choice is what was logged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.control import Controller
from tulip_testbed.sim.measurements import Measurements

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
    if not (np.abs(m.joint_angles[:, at] - m.command[:, at]) < ROUNDING).all():
        return observed
    share = observed.torques[:, at] / observed.torque_limits[at]
    wind_up = observed.nominal.robot.settings.get("drives", {}).get("wind_up", 0.0)
    sag = Controller().error_at_full_torque * share  # the load turns the motor its own way
    motor = m.command[:, at] + sag if m.motor is None else m.motor[:, at]
    angles = observed.joint_angles.copy()
    angles[:, at] = motor + wind_up * share
    return observed.changed(joint_angles=angles)


EFFECT = Effect(
    name="logged-command",
    sentence="The log holds a joint's command in place of its encoder's reading.",
    parameters=(Parameter("source", "", grid=(1,), choices=SOURCES),),
    mechanism=Misreading(_apply, _undo),
    words="The log of the {target} joint holds its {0} in place of its encoder's reading.",
    targets=JOINTS,
)
