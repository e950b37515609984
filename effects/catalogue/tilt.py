"""The floor is not level: it is turned with robot and plates, gravity stays vertical.

The plates' cells measure along the floor's normal. Seen from the floor gravity leans, and its line from
the centre of mass meets the cells' floor further downhill by the height over the cells.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        # The floor turns about the level x, then the level y; observed from it, gravity turns back.
        back = Rotation.from_euler("xy", values).inv()
        spec.option.gravity = back.apply(spec.option.gravity)

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    about_x, about_y = values
    slope = np.array([np.tan(about_y) / np.cos(about_x), -np.tan(about_x)])
    normal = np.cos(about_x) * np.cos(about_y)
    return observed.changed(
        shift=observed.shift + observed.height[:, None] * slope,
        lift=observed.lift + observed.weight * (normal - 1),
    )


EFFECT = Effect(
    name="tilt",
    sentence="The floor with robot and plates is tilted about x, then about y; gravity is vertical.",
    parameters=(
        Parameter("about x", "rad", prior=np.radians(1.0)),
        Parameter("about y", "rad", prior=np.radians(1.0)),
    ),
    inject=_inject,
    predict=_predict,
    words="The floor is tilted by {0} (left side up) and {1} (front down).",
)
