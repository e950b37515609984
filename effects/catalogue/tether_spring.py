"""A cable or hoist pulls the torso back, the more the further it moves: a hanging cable.

Two springs act at the torso's centre of mass, forwards and to the left in the base frame. They have no slack,
and no force where the torso is in the keyframe `stand`. Their other ends are a kilometre away.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.catalogue.tether import FAR, hook, tie, torso_center, without_pull
from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    hooked = hook(rig.robot)

    def edit(spec: mujoco.MjSpec) -> None:
        for name, way in zip("xy", np.eye(2), strict=True):
            tie(spec, f"tether_spring_{name}", hooked, way, values[0], FAR)

    return rig if values[0] == 0 else edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    away = torso_center(observed)[:, :2] - hook(observed.nominal.robot).upright[:2]
    return without_pull(observed, -values[0] * away)


EFFECT = Effect(
    name="tether-spring",
    sentence="Something pulls the torso back horizontally to its place in upright standing, like a spring.",
    parameters=(Parameter("stiffness", "N/m", prior=20.0, positive=True),),
    mechanism=Physics(_inject, _predict),
    words="Something pulls the torso back to its place in upright standing like a spring of {0}.",
)
