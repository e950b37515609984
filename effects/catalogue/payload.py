"""A mass that the model lacks is fixed to a link: a battery, a head or a hanging arm.

The base parameters absorb it completely: the scale weighs the robot with the payload, the identified
parameters are those of the loaded robot, and no residual shows anything. So nothing is removed from an
observation. The parameters differ from those of the robot without the payload.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.targets import LINKS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.specs import compile_spec


def add_mass(spec: mujoco.MjSpec, link: str, mass: float, place: np.ndarray) -> None:
    """Add a point mass to a link's mass, centre of mass and inertia.

    Args:
        place: in the link's frame, (3,) [m].
    """
    model = compile_spec(spec.copy(), spec.modelname)
    body = model.body(link)
    center, before = body.ipos.copy(), float(body.mass[0])
    joined = (before * center + mass * place) / (before + mass)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(body.inertia) @ axes.T
    for part, at in ((before, center), (mass, place)):
        arm = at - joined
        inertia = inertia + part * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    principal, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    edit = spec.body(link)
    edit.explicitinertial = True
    edit.mass, edit.ipos, edit.iquat, edit.inertia = before + mass, joined, quaternion, principal
    edit.fullinertia = np.full(6, np.nan)


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    mass, *place = values

    def edit(spec: mujoco.MjSpec) -> None:
        add_mass(spec, target, mass, np.array(place))

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed


EFFECT = Effect(
    name="payload",
    sentence="A mass is fixed to a link, and the robot was weighed with it (link's frame).",
    parameters=(
        Parameter("mass", "kg", prior=0.5, positive=True),
        Parameter("x", "m", prior=0.1),
        Parameter("y", "m", prior=0.1),
        Parameter("z", "m", prior=0.1),
    ),
    mechanism=Physics(_inject, _predict),
    words="The {target} link carries {0} more, at ({1}, {2}, {3}) in its frame.",
    targets=LINKS,
)
