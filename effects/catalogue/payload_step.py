"""During the experiment a mass is added at a link's centre of mass: a forgotten tool or a hanging cable.

The robot was weighed before. From then on the cells also bear the mass, and the centre of pressure moves
towards the link's centre of mass by the ratio of the mass to the total mass.
"""

from __future__ import annotations

import mujoco

from tulip_testbed.effects.catalogue.payload import add_mass
from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import STARTS, edited, from_then_on
from tulip_testbed.effects.targets import LINKS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    mass, start = values

    def edit(spec: mujoco.MjSpec) -> None:
        add_mass(spec, target, mass, None)

    return from_then_on(rig, start, lambda one: edited(one, edit))


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    mass, start = values
    added = mass * (observed.time_fraction >= start)
    rotations, positions = observed.frames
    number = observed.tree.links.index(target)
    frame, standard = observed.tree.frame_of_link[number], observed.standard[number]
    place = positions[:, frame] + rotations[:, frame] @ (standard[1:] / standard[0])
    gravity = observed.measurements.gravity
    share = added / (observed.weight / gravity + added)
    shift = share[:, None] * (place - observed.center)[:, :2]
    return observed.changed(shift=observed.shift + shift, lift=observed.lift + added * gravity)


EFFECT = Effect(
    name="payload-step",
    sentence="From some time on a link carries an additional mass at its centre of mass.",
    parameters=(Parameter("mass", "kg", prior=0.5), Parameter("start", "", grid=STARTS)),
    mechanism=Physics(_inject, _predict),
    words="The {target} link carries {0} more from {1} of the experiment's time on.",
    targets=LINKS,
)
