"""A mass that the model lacks is fixed to a link: a battery, a head, a hanging arm.

It is absorbed: the scale weighs the robot with it, the base parameters are the loaded robot's own, and no
channel sees anything else. So `predict` changes nothing; what it biases is the robot without it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.point_mass import add_mass
from tulip_testbed.effects.targets import LINKS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    mass, *place = values

    def edit(spec: mujoco.MjSpec) -> None:
        add_mass(spec, target, mass, np.array(place))

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed


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
