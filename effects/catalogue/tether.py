"""A cable or hoist pulls sideways at the torso, with one force in all postures.

In the laboratory a soft spring to a place a kilometre away; the force is in the base frame.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.torso_pull import FAR, hook, pulled, tie
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    force = float(np.linalg.norm(values))
    if force == 0:
        return rig
    hooked, way = hook(rig.robot), np.array(values) / force

    def edit(spec: mujoco.MjSpec) -> None:
        tie(spec, "tether", hooked, way, force / FAR, 0.0)

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return pulled(observed, np.array(values))


EFFECT = Effect(
    name="tether",
    sentence="Something pulls horizontally at the torso's centre of mass with a constant force (base frame).",
    parameters=(Parameter("x", "N", prior=2.0), Parameter("y", "N", prior=2.0)),
    inject=_inject,
    predict=_predict,
    words="Something pulls at the torso with {0} forwards and {1} to the left.",
)
