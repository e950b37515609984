"""The log holds a joint's commanded angle in place of its encoder's reading.

A position servo holds a load only with an error: torque = stiffness (command - angle). So the command differs
from the angle by the load's torque over the servo's stiffness, and that is how the prediction finds the angle
again: command, loads of the nominal robot, nominal stiffness (torque limit over the error at full torque).
The torque of dry friction in the joint is unknown, so the angle is not restored exactly. Without commands in
the measurements nothing can be said, and nothing is removed. Nor does a command have an encoder's noise.

There is no size to estimate; the one choice is which of the two was logged.
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


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    if m.command is None or not values[0]:
        return m
    at = m.joints.index(target)
    angles, spread = m.joint_angles.copy(), m.joint_angles_sd.copy()
    angles[:, at], spread[:, at] = m.command[:, at], 0.0
    return replace(m, joint_angles=angles, joint_angles_sd=spread)


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    command = observed.measurements.command
    if command is None or not values[0]:
        return observed
    at, angles = observed.tree.joints.index(target), observed.joint_angles.copy()
    stiffness = observed.torque_limits[at] / Controller().error_at_full_torque
    # The load turns the joint its own way beyond the command.
    angles[:, at] = command[:, at] + observed.torques[:, at] / stiffness
    return observed.changed(joint_angles=angles)


EFFECT = Effect(
    name="logged-command",
    sentence="The log holds a joint's command in place of its encoder's reading.",
    parameters=(Parameter("source", "", grid=(1,), choices=SOURCES),),
    mechanism=Misreading(_apply, _undo),
    words="The log of the {target} joint holds its {0} in place of its encoder's reading.",
    targets=JOINTS,
)
