"""Both feet's soles yield under their load: a rubber layer tilts as its centre of pressure wanders.

The foot leans towards its load, about the point of the sole below the ankle. It comes beside whatever
compliance the robot's description already states.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.effects.effect import Effect, Parameter, Values
from experiments.effects.injection import always
from experiments.effects.seen import Seen
from sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def softer(one: Rig) -> Rig:
        soft = one.compliance
        return replace(one, compliance=replace(soft, sole_tilt=soft.sole_tilt + values[0]))

    return always(rig, softer)


def _predict(seen: Seen, target: str, values: Values) -> Seen:
    # Load to the front turns about +y, load to the left about -x.
    lean = values[0] * seen.sole_loads[..., ::-1] * np.array([-1.0, 1.0])
    return seen.changed(stance_tilt=seen.stance_tilt + lean[:, 0], swing_tilt=seen.swing_tilt + lean[:, 1])


EFFECT = Effect(
    name="sole-compliance",
    sentence="Both soles yield to roll and pitch about the point below the ankle.",
    parameters=(Parameter("compliance", "rad/Nm", prior=np.radians(0.05), positive=True),),
    inject=_inject,
    predict=_predict,
    words="The soles of both feet yield by {0}.",
)
