"""The soles of both feet yield under load: a rubber layer tilts as the centre of pressure moves.

The foot leans towards its load, about the point of the sole below the ankle. The compliance is added to
the one that the robot's description states.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import always
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.compliance import RIGID
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def softer(one: Rig) -> Rig:
        soft = one.compliance
        return replace(one, compliance=replace(soft, sole_tilt=soft.sole_tilt + values[0]))

    return rig if values[0] < RIGID else always(rig, softer)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    # Load to the front turns about +y, load to the left about -x.
    lean = values[0] * observed.sole_loads[..., ::-1] * np.array([-1.0, 1.0])
    return observed.changed(
        stance_tilt=observed.stance_tilt + lean[:, 0], swing_tilt=observed.swing_tilt + lean[:, 1]
    )


EFFECT = Effect(
    name="sole-compliance",
    sentence="Both soles yield in roll and pitch about the point below the ankle.",
    parameters=(Parameter("compliance", "rad/Nm", prior=np.radians(0.05), positive=True),),
    mechanism=Physics(_inject, _predict),
    words="The soles of both feet yield by {0}.",
)
