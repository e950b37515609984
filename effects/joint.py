"""Effects between a joint's encoder and its link."""

from functools import partial

import mujoco
import numpy as np
from scipy.special import ndtr

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.targets import JOINTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.compliance import RATE, RIGID
from tulip_testbed.sim.rig import Rig

YIELD, PLAY = "_yield", "_play"  # suffixes of second hinges
STIFFNESS = 1e5  # Nm/rad beyond the play, assumed: 0.006 deg under 10 Nm
# s, damping over stiffness, assumed. It acts within the play too: with 50 times as much, a link whose load
# turned round as the robot moved took seconds to the other end, and little of the play was found.
LOSS_TIME = 0.0001
LEAST_STIFFNESS = 1.0  # Nm/rad, for a joint that the closed legs leave free to move


def _add_hinge(spec: mujoco.MjSpec, target: str, suffix: str, **settings: object) -> None:
    """Add a hinge between a joint's encoder and its link."""
    joint = spec.joint(target)
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    joint.parent.add_joint(name=f"{target}{suffix}", type=hinge, axis=joint.axis, pos=joint.pos, **settings)


def _soften(rig: Rig, target: str, values: Values) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        compliance = values[0]
        if (before := spec.joint(f"{target}{YIELD}")) is not None:  # two in series yield together
            compliance += 1.0 / before.stiffness[0]
            spec.delete(before)
        stiffness = 1.0 / compliance
        # Critically damped by an inertia of its own, which has no weight: at rest it makes no difference.
        # With less, stiff springs in both ankles never came to rest at the simulation's time step.
        inertia = stiffness / RATE**2
        damping = [2.0 * inertia * RATE, 0.0, 0.0]
        _add_hinge(spec, target, YIELD, stiffness=[stiffness, 0.0, 0.0], damping=damping, armature=inertia)

    return rig if values[0] < RIGID else edited(rig, edit)


def _yielded(observed: Observation, target: str, values: Values) -> Observation:
    column = observed.tree.joints.index(target)
    yielded = _turned(observed, target, values[0] * observed.torques[:, column])
    if not observed.moves:
        return yielded
    return yielded.accelerated(values[0] * observed.motion.yielding[..., column])


def _loosen(rig: Rig, target: str, values: Values) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        name, half = f"{target}{PLAY}", values[0] / 2
        damping = [LOSS_TIME * STIFFNESS, 0.0, 0.0]
        _add_hinge(spec, target, PLAY, damping=damping, armature=spec.joint(target).armature)
        spring = spec.add_tendon(name=name, stiffness=[STIFFNESS, 0.0, 0.0], springlength=[-half, half])
        spring.wrap_joint(name, 1.0)

    return rig if values[0] == 0 else edited(rig, edit)


def _at_rest(observed: Observation, target: str, values: Values) -> Observation:
    return _turned(observed, target, _rest(observed, target, values[0] / 2)[0])


def _off_rest(observed: Observation, target: str, values: Values) -> Observation:
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
    # Between the ends a turn by d takes up a load of held times d, of which cells do not show stiffness times
    # d. The larger that range of loads, the more likely the link rests there.
    more = np.maximum(loads.held[:, column] / stiffness, 1.0)
    below, between, above = ndtr(low), more * (ndtr(high) - ndtr(low)), ndtr(-high)
    edge_low, edge_high = (more * np.exp(-0.5 * edge**2) / np.sqrt(2 * np.pi) for edge in (low, high))
    all_cases = below + between + above
    mean = half * (above - below) + turn * between + sd * (edge_low - edge_high)
    square = half**2 * (above + below) + (turn**2 + sd**2) * between
    square += sd * ((turn - half) * edge_low - (turn + half) * edge_high)
    mean, square = mean / all_cases, square / all_cases
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0))


_on_joint = partial(Effect, targets=JOINTS)


EFFECTS = (
    _on_joint(
        name="joint-compliance",
        sentence="A joint yields between encoder and link, in the direction of its load.",
        parameters=(Parameter("compliance", "rad/Nm", prior=np.radians(0.05), positive=True),),
        mechanism=Physics(_soften, _yielded),
        words="The {target} joint yields by {0} between its encoder and its link.",
        explanation="A joint yields between its encoder and its link: the link turns, but the encoder does "
        "not see "
        "it.",
    ),
    _on_joint(
        name="backlash",
        sentence="A joint has free play between encoder and link, and its load presses it to one end.",
        parameters=(Parameter("play", "rad", prior=np.radians(0.5), positive=True),),
        mechanism=Physics(_loosen, _at_rest, _off_rest),
        words="The {target} joint has a free play of {0} between its encoder and its link.",
        explanation="""A joint has free play between its encoder and its link.

        The link rests at one end of the play, where its load presses it. In closed legs it stops between the
        ends if that takes all load off the joint. The simulation adds a second hinge behind the encoder with
        a dead band as wide as the play and a stiff spring beyond it.

        The torque on a joint is known within a few tenths of a newton metre. Where the load is no larger, the
        link may rest anywhere in its play; the prediction is the mean, and `unsure` the spread about it. If
        it mostly rests between the ends, the data show little more of the play than the part that it used.
        """,
    ),
)
