"""The cells stand further from their plate's middle than the data sheet says, by one ratio.

It stretches every foot's centre of pressure about its plate's middle.
"""

from __future__ import annotations

import mujoco

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.plates import cell_names
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    factor = [1 + values[0], 1 + values[0], 1.0]

    def edit(spec: mujoco.MjSpec) -> None:
        for name in cell_names():
            hung = spec.body(f"{name}_cell")  # where cells give way
            for part in [spec.geom(name), spec.site(name)] if hung is None else [hung]:
                part.pos = part.pos * factor

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cells=observed.cells * (1 + values[0]))


EFFECT = Effect(
    name="cell-position-scale",
    sentence="The cells stand at (1 + scale) times their stated places about their plates' middles.",
    parameters=(Parameter("scale", "", prior=0.02),),
    inject=_inject,
    predict=_predict,
    words="The cells stand further from their plates' middles than stated by {0}.",
)
