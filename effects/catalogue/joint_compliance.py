"""A joint yields between its encoder and its link: the link turns, but the encoder does not see it."""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited, indicator
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.compliance import RATE, RIGID
from tulip_testbed.sim.rig import Rig

SUFFIX = "_yield"


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        joint, compliance = spec.joint(target), values[0]
        if (before := spec.joint(f"{target}{SUFFIX}")) is not None:  # two in series yield together
            compliance += 1.0 / before.stiffness[0]
            spec.delete(before)
        stiffness = 1.0 / compliance
        # Critically damped by an inertia of its own, which has no weight: at rest it makes no difference.
        # With less, stiff springs in both ankles never came to rest at the simulation's time step.
        inertia = stiffness / RATE**2
        joint.parent.add_joint(
            name=f"{target}{SUFFIX}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            pos=joint.pos,
            stiffness=[stiffness, 0.0, 0.0],
            damping=[2.0 * inertia * RATE, 0.0, 0.0],
            armature=inertia,
        )

    return rig if values[0] < RIGID else edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    yielded = values[0] * observed.torques * indicator(observed.tree.joints, target)
    return observed.changed(joint_angles=observed.joint_angles + yielded)


EFFECT = Effect(
    name="joint-compliance",
    sentence="A joint yields between encoder and link, in the direction of its load.",
    parameters=(Parameter("compliance", "rad/Nm", prior=np.radians(0.05), positive=True),),
    mechanism=Physics(_inject, _predict),
    words="The {target} joint yields by {0} between its encoder and its link.",
    targets=JOINTS,
)
