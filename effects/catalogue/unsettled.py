"""The robot is read before it has come to rest: the wait after every move is too short.

The simulation reads a full window that begins this time after the robot is released, or when dry friction
first holds the load if that is later, whether the robot rests or not. A robot that creeps is in equilibrium
at every moment, and angles and cells are averaged over the same window, so no residual shows the creep. A
swaying robot shifts the mean centre of pressure only by its mean horizontal acceleration over the window,
times height over gravity. So nothing is removed from an observation: only the standard deviation of the
readings within a window shows the effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
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
    sentence="The robot is read this long after its release, whether it has come to rest or not.",
    parameters=(Parameter("settling", "s", prior=2.0, positive=True),),
    mechanism=Physics(_inject, _predict),
    words="The robot was read {0} after its release.",
    statics=False,
)
