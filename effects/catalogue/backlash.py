"""A joint has free play between its encoder and its link.

The link rests at one end of the play, where its load presses it. In closed legs it stops between the ends
if that takes all load off the joint. The simulation adds a second hinge behind the encoder with a dead band
as wide as the play and a stiff spring beyond it.

The torque on a joint is known within a few tenths of a newton metre. Where the load is no larger, the link
may rest anywhere in its play; the prediction is the mean, and `_unsure` the spread about it.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.special import ndtr

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
    return _turned(observed, target, _rest(observed, target, values[0] / 2)[0])


def _unsure(observed: Observation, target: str, values: Values) -> Observation:
    mean, sd = _rest(observed, target, values[0] / 2)
    return _turned(observed, target, mean + sd)


def _turned(observed: Observation, target: str, angle: np.ndarray) -> Observation:
    angles = observed.joint_angles.copy()
    angles[:, observed.tree.joints.index(target)] += angle
    return observed.changed(joint_angles=angles)


def _rest(observed: Observation, target: str, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and s.d. of where in its play a link rests, from the middle, (m,) each [rad].

    The torque has a normal distribution. It turns the link by torque over stiffness, up to half the play.
    """
    if half < 0:  # where a step of a fit may end: continued so that its derivative is that at zero
        mean, sd = _rest(observed, target, -half)
        return -mean, sd
    loads, column = observed.loads, observed.tree.joints.index(target)
    stiffness = np.maximum(loads.stiffness[:, column], LEAST_STIFFNESS)
    turn = loads.torques[:, column] / stiffness
    sd = np.maximum(loads.doubt[:, column] / stiffness, 1e-12)
    low, high = (-half - turn) / sd, (half - turn) / sd
    below, between, above = ndtr(low), ndtr(high) - ndtr(low), ndtr(-high)
    edge_low, edge_high = (np.exp(-0.5 * edge**2) / np.sqrt(2 * np.pi) for edge in (low, high))
    mean = half * (above - below) + turn * between + sd * (edge_low - edge_high)
    square = half**2 * (above + below) + (turn**2 + sd**2) * between
    square += sd * ((turn - half) * edge_low - (turn + half) * edge_high)
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0))


EFFECT = Effect(
    name="backlash",
    sentence="A joint has free play between encoder and link, and its load presses it to one end.",
    parameters=(Parameter("play", "rad", prior=np.radians(0.5), positive=True),),
    mechanism=Physics(_inject, _predict, _unsure),
    words="The {target} joint has a free play of {0} between its encoder and its link.",
    targets=JOINTS,
)
