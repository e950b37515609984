"""A joint has free play between its encoder and its link.

The link rests at one end of the play, where its load presses it. In closed legs it stops between the ends
if that takes all load off the joint. The simulation adds a second hinge behind the encoder with a dead band
as wide as the play and a stiff spring beyond it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig

SUFFIX = "_play"
STIFFNESS = 1e5  # Nm/rad beyond the play, assumed: 0.006 deg under 10 Nm
LOSS_TIME = 0.005  # s, damping over stiffness, assumed; at rest it makes no difference
LEAST_STIFFNESS = 1.0  # Nm/rad, for a joint that the closed legs leave free to move


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        joint, half = spec.joint(target), values[0] / 2
        joint.parent.add_joint(
            name=f"{target}{SUFFIX}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            pos=joint.pos,
            damping=[LOSS_TIME * STIFFNESS, 0.0, 0.0],
            armature=joint.armature,
        )
        spring = spec.add_tendon(
            name=f"{target}{SUFFIX}", stiffness=[STIFFNESS, 0.0, 0.0], springlength=[-half, half]
        )
        spring.wrap_joint(f"{target}{SUFFIX}", 1.0)

    return rig if values[0] == 0 else edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    half, column = values[0] / 2, observed.tree.joints.index(target)
    stiffness = np.maximum(observed.loads.stiffness[:, column], LEAST_STIFFNESS)
    angles = observed.joint_angles.copy()
    angles[:, column] += np.clip(observed.torques[:, column] / stiffness, -half, half)
    return observed.changed(joint_angles=angles)


EFFECT = Effect(
    name="backlash",
    sentence="A joint has free play between encoder and link, and its load presses it to one end.",
    parameters=(Parameter("play", "rad", prior=np.radians(0.5), positive=True),),
    mechanism=Physics(_inject, _predict),
    words="The {target} joint has a free play of {0} between its encoder and its link.",
    targets=JOINTS,
)
