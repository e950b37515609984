"""Drives that hold a robot: torque limits, rotor inertia, damping and dry friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import listed
from tulip_testbed.experiments.robot_import.skeleton import Hinge, Skeleton
from tulip_testbed.sim.drive_needs import LEAST_ARMATURE

# Per Nm of torque limit, as TULip's drives.
ARMATURE, DAMPING, FRICTION = 0.003, 0.04, 0.05  # kg m2, Nm s, Nm
STRENGTH = 0.4  # torque limit over weight times length of a leg, where the file gives none
UNLIMITED = np.radians(90.0)  # either way, for hinges without limits
GRAVITY = 9.81  # m/s2


def with_drives(skeleton: Skeleton, leg: float) -> tuple[Skeleton, list[str]]:
    """Complete the drives of all hinges.

    Args:
        leg: length of a leg [m].

    Returns:
        the skeleton with torque, armature, damping, friction and range of every hinge; what was assumed.
    """
    usual = STRENGTH * skeleton.mass * GRAVITY * leg
    lacking: dict[str, list[str]] = {
        f"torque limit {usual:.3g} Nm ({STRENGTH:g} of the weight times the leg's length)": [],
        f"rotor inertia {ARMATURE:g} kg m2 per Nm of torque limit": [],
        f"damping {DAMPING:g} Nm s per Nm of torque limit": [],
        f"dry friction {FRICTION:g} of the torque limit": [],
        f"range of {np.degrees(UNLIMITED):g} deg either way": [],
    }

    def completed(hinge: Hinge) -> Hinge:
        torque = float(hinge.torque or usual)
        lacks = (
            hinge.torque is None,
            hinge.armature < LEAST_ARMATURE * torque,
            hinge.damping <= 0,
            hinge.friction <= 0,
            not np.isfinite(hinge.range).all(),
        )
        for names, lack in zip(lacking.values(), lacks, strict=True):
            names += [hinge.name] * lack
        _, weak, loose, slick, free = lacks
        return replace(
            hinge,
            torque=torque,
            armature=ARMATURE * torque if weak else hinge.armature,
            damping=DAMPING * torque if loose else hinge.damping,
            friction=FRICTION * torque if slick else hinge.friction,
            range=np.array([-UNLIMITED, UNLIMITED]) if free else np.clip(hinge.range, -np.pi, np.pi),
        )

    links = [replace(link, hinges=tuple(map(completed, link.hinges))) for link in skeleton.links]
    count = len(skeleton.hinges)
    assumed = [
        f"{words} for {'all joints' if len(names) == count else listed(names)}"
        for words, names in lacking.items()
        if names
    ]
    return Skeleton(tuple(links)), assumed
