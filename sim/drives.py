"""The drives of a scene: their flexibility and backlash, and what a servo needs to hold them.

The laboratory supplies in its own scene the rotor inertia and the friction that a robot's file lacks; the
file stays as it is.
"""

from dataclasses import dataclass

import mujoco

from tulip_testbed.base.errors import InputError
from tulip_testbed.sim.control import joint_torques, torque_limit

SUFFIX = "_motor"
# Ratio of damping to stiffness of the flexible element, which keeps the links from ringing [s], assumed. It
# acts on the joint's own speed, where it is integrated implicitly, and has no effect at rest.
LOSS_TIME = 0.001
# Share of the drive's reflected inertia on the joint side of the spring, assumed.
LINK_SHARE = 0.2
# A servo reaches its torque limit at 0.02 rad: with less inertia its damping makes the joint chatter.
LEAST_ARMATURE = 0.0014  # kg m2 per Nm of torque limit
ROUNDING = 1e-6  # relative
# Friction rows softer than this let a joint creep for long before it sticks (docs/explanation/laboratory.md).
SOLREF_FRICTION = (0.002, 1.0)
SOLIMP_FRICTION = (0.9999, 0.9999, 0.001, 0.5, 2.0)
LEAST_RATE = 2 / SOLREF_FRICTION[0]  # 1/s


@dataclass(frozen=True)
class Drives:
    """Flexibility of all drives by one rule, as `Controller` has one for all servos.

    Attributes:
        wind_up: angle between motor and joint at the torque limit [rad]; stiffness = torque limit /
            wind_up; 0 means rigid.
        backlash: whole width of the free play between motor and joint, at the joint [rad].
    """

    wind_up: float = 0.0
    backlash: float = 0.0


def add_drives(spec: mujoco.MjSpec, drives: Drives) -> None:
    """Add a rotor to every actuated joint, with a spring and a dead band between them.

    The rotor takes over the actuator and the drive's inertia and friction; it turns the joint by
    a fixed tendon whose length is joint minus motor angle. Rigid drives stay unchanged.
    """
    if drives.wind_up <= 0 and drives.backlash > 0:
        raise InputError(f"drives: found a backlash of {drives.backlash} rad and no wind_up, expected both")
    if drives.wind_up <= 0:
        return
    for actuator in spec.actuators:
        joint = spec.joint(actuator.target)
        body = joint.parent.parent.add_body(name=f"{joint.name}{SUFFIX}", mass=1e-9, inertia=[1e-9] * 3)
        body.explicitinertial, body.ipos = True, [0, 0, 0]
        motor = body.add_joint(
            name=f"{joint.name}{SUFFIX}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            ref=joint.ref,
            armature=(1 - LINK_SHARE) * joint.armature,
            actfrclimited=joint.actfrclimited,
            actfrcrange=joint.actfrcrange,
            frictionloss=joint.frictionloss,
            damping=joint.damping,
            solref_friction=joint.solref_friction,
            solimp_friction=joint.solimp_friction,
        )
        stiffness = torque_limit(spec, actuator) / drives.wind_up
        spring = spec.add_tendon(
            name=motor.name, stiffness=stiffness, springlength=[-drives.backlash / 2, drives.backlash / 2]
        )
        spring.wrap_joint(joint.name, 1.0)
        spring.wrap_joint(motor.name, -1.0)
        actuator.target = motor.name
        joint.frictionloss, joint.armature = 0.0, LINK_SHARE * joint.armature
        joint.damping = [LOSS_TIME * stiffness, 0.0, 0.0]


def motor_joint(model: mujoco.MjModel, joint: str) -> str:
    """Return the name of the joint that a joint's motor turns: its rotor, or itself in a rigid drive."""
    rotor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"{joint}{SUFFIX}")
    return f"{joint}{SUFFIX}" if rotor >= 0 else joint


def short_of_armature(spec: mujoco.MjSpec) -> dict[str, tuple[float, float]]:
    """Return the armature of the joints that have too little, and what they need, by joint [kg m2]."""
    out = {}
    for name, torque in joint_torques(spec).items():
        found, needed = float(spec.joint(name).armature), LEAST_ARMATURE * torque
        if found < (1 - ROUNDING) * needed:
            out[name] = (found, needed)
    return out


def soft_friction(spec: mujoco.MjSpec) -> list[str]:
    """List the joints whose dry friction would creep."""
    return [
        joint.name
        for joint in spec.joints
        if joint.frictionloss > 0 and not _holds(joint.solref_friction, joint.solimp_friction)
    ]


def supply_drives(spec: mujoco.MjSpec) -> None:
    """Give the drives of a scene the armature and the stiff friction that they lack."""
    for name, (_, needed) in short_of_armature(spec).items():
        spec.joint(name).armature = needed
    for name in soft_friction(spec):
        joint = spec.joint(name)
        joint.solref_friction, joint.solimp_friction = SOLREF_FRICTION, SOLIMP_FRICTION


def _holds(solref, solimp) -> bool:
    """Whether a friction row damps as fast and has as high an impedance as the laboratory's."""
    first, second = solref
    rate = 2 / first if first > 0 else -second  # negative numbers are stiffness and damping
    least = min(solimp[:2])
    return rate >= (1 - ROUNDING) * LEAST_RATE and least >= SOLIMP_FRICTION[0] - ROUNDING
