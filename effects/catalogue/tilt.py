"""The floor is not level: robot and plates are tilted with it, gravity stays vertical.

The cells measure along the floor's normal. In the floor's axes gravity is tilted, so the centre of pressure
lies downhill of the centre of mass, by its height over the cells times the slope.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        # The floor is rotated about the level x, then the level y: in its axes gravity rotates back.
        back = Rotation.from_euler("xy", values).inv()
        spec.option.gravity = back.apply(spec.option.gravity)

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    about_x, about_y = values
    slope = np.array([np.tan(about_y) / np.cos(about_x), -np.tan(about_x)])
    normal = np.cos(about_x) * np.cos(about_y)
    return observed.changed(
        shift=observed.shift + observed.height[:, None] * slope,
        lift=observed.lift + observed.loaded_weight * (normal - 1),
    )


EFFECT = Effect(
    name="tilt",
    sentence="The floor is tilted with robot and plates, about x, then about y; gravity stays vertical.",
    parameters=(
        Parameter("about x", "rad", prior=np.radians(1.0)),
        Parameter("about y", "rad", prior=np.radians(1.0)),
    ),
    mechanism=Physics(_inject, _predict),
    words="The floor is tilted by {0} (left side up) and {1} (front down).",
)
