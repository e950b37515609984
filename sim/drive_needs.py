"""The properties a drive needs so that a servo can hold it: rotor inertia, and friction that holds.

The laboratory supplies in its own scene what a robot's file lacks; the file stays as it is.
"""

from __future__ import annotations

import mujoco

from tulip_testbed.sim.control import joint_torques

# A servo reaches its torque limit at 0.02 rad: with less inertia its damping makes the joint chatter.
LEAST_ARMATURE = 0.0014  # kg m2 per Nm of torque limit
ROUNDING = 1e-6  # relative
# Friction rows softer than this let a joint creep for long before it sticks (docs/studies/contact-study.md).
SOLREF_FRICTION = (0.002, 1.0)
SOLIMP_FRICTION = (0.9999, 0.9999, 0.001, 0.5, 2.0)
LEAST_RATE = 2 / SOLREF_FRICTION[0]  # 1/s


def short_of_armature(spec: mujoco.MjSpec) -> dict[str, tuple[float, float]]:
    """Return the armature of the joints that have too little, and what they need, by joint [kg m2].

    Raises:
        InputError: a drive that pushes one way only.
    """
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
    """Give the drives of a scene the armature and the stiff friction that they lack.

    Raises:
        InputError: a drive that pushes one way only.
    """
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
