"""Drives that hold a robot: torque limits, rotor inertia, damping and dry friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import listed
from tulip_testbed.experiments.robot_import.skeleton import Array, Hinge, Skeleton
from tulip_testbed.sim.drives import LEAST_ARMATURE

# Per Nm of torque limit, as TULip's drives.
ARMATURE, DAMPING, FRICTION = 0.003, 0.04, 0.05  # kg m2, Nm s, Nm
STRENGTH = 0.4  # torque limit over weight times length of a leg, where the file gives none
UNLIMITED = np.radians(90.0)  # either way, for hinges without limits


@dataclass(frozen=True)
class Drive:
    """A joint's drive.

    Attributes:
        torque: limit [Nm].
        armature, damping, friction: [kg m2, Nm s, Nm].
        range: of the joint, (2,) [rad].
    """

    torque: float
    armature: float
    damping: float
    friction: float
    range: Array


def drives_of(skeleton: Skeleton, leg: float, gravity: float = 9.81) -> tuple[dict[str, Drive], list[str]]:
    """Complete the drives of all hinges.

    Args:
        leg: length of a leg [m].

    Returns:
        the drives by joint; what was assumed.
    """
    usual = STRENGTH * skeleton.mass * gravity * leg
    found: dict[str, Drive] = {}
    lacking: dict[str, list[str]] = {"torque": [], "armature": [], "damping": [], "friction": [], "range": []}

    def note(kind: str, hinge: Hinge, lacks: bool) -> bool:
        if lacks:
            lacking[kind].append(hinge.name)
        return lacks

    for hinge in skeleton.hinges:
        torque = usual if note("torque", hinge, hinge.torque is None) else float(hinge.torque or usual)
        weak = note("armature", hinge, hinge.armature < LEAST_ARMATURE * torque)
        loose = note("damping", hinge, hinge.damping <= 0)
        slick = note("friction", hinge, hinge.friction <= 0)
        free = note("range", hinge, not np.isfinite(hinge.range).all())
        found[hinge.name] = Drive(
            torque=torque,
            armature=ARMATURE * torque if weak else hinge.armature,
            damping=DAMPING * torque if loose else hinge.damping,
            friction=FRICTION * torque if slick else hinge.friction,
            range=np.array([-UNLIMITED, UNLIMITED]) if free else np.clip(hinge.range, -np.pi, np.pi),
        )
    words = {
        "torque": f"torque limit {usual:.3g} Nm ({STRENGTH:g} of the weight times the leg's length)",
        "armature": f"rotor inertia {ARMATURE:g} kg m2 per Nm of torque limit",
        "damping": f"damping {DAMPING:g} Nm s per Nm of torque limit",
        "friction": f"dry friction {FRICTION:g} of the torque limit",
        "range": f"range of {np.degrees(UNLIMITED):g} deg either way",
    }
    count = len(skeleton.hinges)
    assumed = [
        f"{words[kind]} for {'all joints' if len(names) == count else listed(names)}"
        for kind, names in lacking.items()
        if names
    ]
    return found, assumed
