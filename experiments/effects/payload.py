"""A mass that the model lacks is fixed to a link: a battery, a head, a hanging arm.

It is absorbed: the scale weighs the robot with it, the base parameters are the loaded robot's own, and no
channel sees anything else. So `predict` changes nothing; what it biases is the robot without it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from experiments.effects.effect import Effect, Parameter, Values
from experiments.effects.inertial import add_mass
from experiments.effects.injection import edited
from experiments.effects.seen import Seen
from experiments.effects.targets import LINKS
from sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    mass, *place = values

    def edit(spec: mujoco.MjSpec) -> None:
        add_mass(spec, target, mass, np.array(place))

    return edited(rig, edit)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    return seen


EFFECT = Effect(
    name="payload",
    sentence="A mass is fixed to a link, and the scale weighed the robot with it (link's frame).",
    parameters=(
        Parameter("mass", "kg", prior=0.5, positive=True),
        Parameter("x", "m", prior=0.1),
        Parameter("y", "m", prior=0.1),
        Parameter("z", "m", prior=0.1),
    ),
    inject=_inject,
    predict=_predict,
    words="The {target} link carries {0} more, at ({1}, {2}, {3}) in its frame.",
    targets=LINKS,
)
