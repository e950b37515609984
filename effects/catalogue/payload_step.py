"""A mass is added at a link's nominal centre of mass: a forgotten tool or a hanging cable.

The robot was weighed before. From then on the cells also bear the mass, and the centre of pressure moves
towards that point by the ratio of the mass to the total mass.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.catalogue.payload import add_mass
from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import STARTS, edited, from_then_on
from tulip_testbed.effects.targets import LINKS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    mass, start = values

    def edit(spec: mujoco.MjSpec) -> None:
        add_mass(spec, target, mass, _place(rig.robot, target))

    return from_then_on(rig, start, lambda one: edited(one, edit))


def _place(robot: Robot, link: str) -> np.ndarray:
    """Return the centre of mass of a link by its model, which is known, in the link's frame, (3,) [m]."""
    return robot.model.body(link).ipos.copy()


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    mass, start = values
    added = mass * (observed.time_fraction >= start)
    rotations, positions = observed.frames
    number = observed.tree.links.index(target)
    frame = observed.tree.frame_of_link[number]
    place = positions[:, frame] + rotations[:, frame] @ _place(observed.nominal.robot, target)
    gravity = observed.measurements.gravity
    share = added / (observed.loaded_weight / gravity + added)
    shift = share[:, None] * (place - observed.loaded_center)[:, :2]
    return observed.changed(shift=observed.shift + shift, lift=observed.lift + added * gravity)


EFFECT = Effect(
    name="payload-step",
    sentence="From some time on a link carries an additional mass at its nominal centre of mass.",
    parameters=(Parameter("mass", "kg", prior=0.5), Parameter("start", "", grid=STARTS)),
    mechanism=Physics(_inject, _predict),
    words="The {target} link carries {0} more from {1} of the experiment's time on.",
    targets=LINKS,
)
