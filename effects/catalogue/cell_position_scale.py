"""All load cells are further from the centres of their plates than the data sheet says, by one ratio.

The error stretches the centre of pressure of each foot about the centre of its plate.
"""

from __future__ import annotations

import mujoco

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.plates import cell_names
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    factor = [1 + values[0], 1 + values[0], 1.0]

    def edit(spec: mujoco.MjSpec) -> None:
        for name in cell_names():
            hung = spec.body(f"{name}_cell")  # compliant cells are bodies of their own
            for part in [spec.geom(name), spec.site(name)] if hung is None else [hung]:
                part.pos = part.pos * factor

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cells=observed.cells * (1 + values[0]))


EFFECT = Effect(
    name="cell-position-scale",
    sentence="The cells lie at (1 + scale) times their stated distances from the centres of their plates.",
    parameters=(Parameter("scale", "", prior=0.02),),
    mechanism=Physics(_inject, _predict),
    words="The cells lie {0} further from the centres of their plates than stated.",
    instrument="cells",
)
