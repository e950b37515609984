"""A cable or hoist pulls the torso back sideways, the more the further it moves: a hanging cable.

Two springs at the torso's centre of mass, forwards and to the left in the base frame, without slack and
without force where the torso is in the keyframe `stand`; their other ends are a kilometre away.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.torso_pull import FAR, hook, pulled, tie, torso_place
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    hooked = hook(rig.robot)

    def edit(spec: mujoco.MjSpec) -> None:
        for name, way in zip("xy", np.eye(2), strict=True):
            tie(spec, f"tether_spring_{name}", hooked, way, values[0], FAR)

    return rig if values[0] == 0 else edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    away = torso_place(observed)[:, :2] - hook(observed.nominal.robot).upright[:2]
    return pulled(observed, -values[0] * away)


EFFECT = Effect(
    name="tether-spring",
    sentence="Something pulls the torso back horizontally to its place in upright standing, like a spring.",
    parameters=(Parameter("stiffness", "N/m", prior=20.0, positive=True),),
    inject=_inject,
    predict=_predict,
    words="Something pulls the torso back like a spring of {0}.",
)
