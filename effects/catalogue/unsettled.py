"""The robot is read before it has come to rest: too short a wait after every move.

The laboratory reads a full window from this time after the robot is released on, or from when dry friction
first holds the load if that is later, at rest or not. A robot that creeps stands in equilibrium at every
moment, and angles and cells are averaged over one window, so no channel shows the creeping; what is left is
swaying, whose mean is the change of the centre of mass's speed over the window, times its height over
gravity. `predict` therefore changes nothing: the effect cannot be seen here, only in the s.d. of the
readings within a window.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import always
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.dynamics.hold import CONTROL_PERIOD
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def sooner(one: Rig) -> Rig:
        hasty = replace(
            one.protocol,
            hold_time=one.protocol.window + values[0],
            speed_gate=np.inf,
            force_gate=np.inf,
            calm_time=CONTROL_PERIOD,
            gated=False,
        )
        return replace(one, protocol=hasty)

    return always(rig, sooner)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed


EFFECT = Effect(
    name="unsettled",
    sentence="The robot is read this time after its release, whether it has come to rest or not.",
    parameters=(Parameter("settling", "s", prior=2.0, positive=True),),
    inject=_inject,
    predict=_predict,
    words="The robot was given {0} to settle.",
    statics=False,
)
