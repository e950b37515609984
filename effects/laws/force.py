"""A force on a link that nobody knows of, in the base frame: constant, from a time on, or growing with time.

The simulation ties the link's centre of mass by a soft spring to a point a kilometre away. Its removal moves
the centre of pressure by the force's moment about the floor of the cells; what pulls down is added to the
weight. The link's centre of mass is that of the nominal robot.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tulip_testbed.effects.effect import Values
from tulip_testbed.effects.injection import edited, from_then_on
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import sentence_of
from tulip_testbed.effects.ropes import FAR, hook, tie_to, without_force
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig

AXES = ("x", "y", "z")
STAGES = 20  # in which a force grows: half of one is 2.5 % of it


def inject(rig: Rig, target: str, values: Values) -> Rig:
    """Return the laboratory with the force."""
    sentence, force = sentence_of(target), np.array(values[:3])
    size = float(np.linalg.norm(force))
    if size == 0:
        return rig
    hooked = hook(rig.robot, sentence.place)
    anchor = hooked.upright + FAR * force / size

    def pulling(count: int, part: float) -> Callable[[Rig], Rig]:
        name = f"force_{sentence.place}_{sentence.quantity}_{count}"
        return lambda one: edited(
            one, lambda spec: tie_to(spec, name, hooked, anchor, part * size / FAR, 0.0)
        )

    if sentence.quantity == g.NOTHING:
        return pulling(0, 1.0)(rig)
    if sentence.form == g.STEP:
        return from_then_on(rig, values[3], pulling(0, 1.0))
    for count in range(STAGES):
        rig = from_then_on(rig, (count + 0.5) / STAGES, pulling(count, 1 / STAGES))
    return rig


def remove(observed: Observation, target: str, values: Values) -> Observation:
    """Return the observation without the force."""
    sentence = sentence_of(target)
    time = observed.time_fraction
    part = {g.CONSTANT: np.ones(len(time)), g.LINEAR: time}.get(sentence.form)
    force = np.outer(time >= values[3] if part is None else part, values[:3])
    return without_force(observed, sentence.place, force)
