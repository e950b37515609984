"""Drives that hold a robot: torque limits, rotor inertia, damping and dry friction."""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.base.errors import listed
from tulip_testbed.sim.drives import LEAST_ARMATURE, SOLIMP_FRICTION, SOLREF_FRICTION

# Per Nm of torque limit, as TULip's drives.
ARMATURE, DAMPING, FRICTION = 0.003, 0.04, 0.05  # kg m2, Nm s, Nm
STRENGTH = 0.4  # torque limit over weight times length of a leg, where the file gives none
MOST_STRENGTH = 100.0  # times as much: a number that stands for no limit
UNLIMITED = np.radians(90.0)  # either way, for hinges without limits
WIDEST = np.pi + 0.01  # rad: files round
GRAVITY = 9.81  # m/s2


def complete_drives(spec: mujoco.MjSpec, torques: dict[str, float], mass: float, leg: float) -> list[str]:
    """Complete the hinges of a robot and give each a motor.

    Args:
        spec: the robot, which is changed.
        torques: limits that the file gives, by joint [Nm].
        mass: of the robot [kg]. leg: its length [m].

    Returns:
        what was assumed.
    """
    usual = STRENGTH * mass * GRAVITY * leg
    hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    lacking: dict[str, list[str]] = {
        f"torque limit {usual:.3g} Nm ({STRENGTH:g} of the weight times the leg's length)": [],
        f"torque limit {usual:.3g} Nm instead of the file's, over {MOST_STRENGTH:g} times as much": [],
        f"rotor inertia {ARMATURE:g} kg m2 per Nm of torque limit": [],
        f"damping {DAMPING:g} Nm s per Nm of torque limit": [],
        f"dry friction {FRICTION:g} of the torque limit": [],
        f"range of {np.degrees(UNLIMITED):g} deg either way": [],
        "range of 180 deg either way instead of the file's wider one": [],
    }
    for hinge in hinges:
        given = torques.get(hinge.name, 0.0)
        boundless = given > MOST_STRENGTH * usual
        torque = usual if boundless or not given else given
        limited = hinge.limited == mujoco.mjtLimited.mjLIMITED_TRUE
        lacks = (
            not given,
            boundless,
            hinge.armature < LEAST_ARMATURE * torque,
            hinge.damping[0] <= 0,
            hinge.frictionloss <= 0,
            not limited,
            limited and max(np.abs(hinge.range)) > WIDEST,
        )
        for names, lack in zip(lacking.values(), lacks, strict=True):
            names += [hinge.name] * bool(lack)
        _, _, weak, loose, slick, *_ = lacks
        hinge.armature = ARMATURE * torque if weak else hinge.armature
        hinge.damping = [DAMPING * torque if loose else hinge.damping[0], 0, 0]
        hinge.frictionloss = FRICTION * torque if slick else hinge.frictionloss
        hinge.range = np.clip(hinge.range, -np.pi, np.pi) if limited else [-UNLIMITED, UNLIMITED]
        hinge.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        hinge.solref_friction, hinge.solimp_friction = SOLREF_FRICTION, SOLIMP_FRICTION
        motor = spec.add_actuator(name=hinge.name, target=hinge.name, gear=[1, 0, 0, 0, 0, 0])
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.forcelimited, motor.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-torque, torque]
    return [
        f"{words} for {'all joints' if len(names) == len(hinges) else listed(names)}"
        for words, names in lacking.items()
        if names
    ]
