"""A force on a link that nobody knows of, in the base frame: constant, from a time on, or growing with time.

The simulation ties the link's centre of mass by a soft spring to a point a kilometre away. Its removal moves
the centre of pressure by the force's moment about the floor of the cells; what pulls down is added to the
weight. The link's centre of mass is that of the nominal robot.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from tulip_testbed.effects.catalogue.tether import FAR, link_center, upright_center
from tulip_testbed.effects.effect import Values
from tulip_testbed.effects.injection import edited, from_then_on
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import sentence_of
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
    anchor = upright_center(rig.robot, sentence.place) + FAR * force / size
    point = rig.robot.model.body(sentence.place).ipos.copy()

    def pulling(count: int, part: float) -> Callable[[Rig], Rig]:
        name = f"force_{sentence.place}_{sentence.quantity}_{count}"

        def edit(spec: mujoco.MjSpec) -> None:
            spec.worldbody.add_site(name=f"{name}_anchor", pos=anchor)
            spec.body(sentence.place).add_site(name=f"{name}_hook", pos=point)
            rope = spec.add_tendon(
                name=name, stiffness=[part * size / FAR, 0.0, 0.0], springlength=[0.0, 0.0]
            )
            rope.wrap_site(f"{name}_anchor")
            rope.wrap_site(f"{name}_hook")

        return lambda one: edited(one, edit)

    if sentence.quantity == g.NOTHING:
        return pulling(0, 1.0)(rig)
    if sentence.form == g.STEP:
        return from_then_on(rig, values[3], pulling(0, 1.0))
    for count in range(STAGES):
        rig = from_then_on(rig, (count + 0.5) / STAGES, pulling(count, 1 / STAGES))
    return rig


def predict(observed: Observation, target: str, values: Values) -> Observation:
    """Return the observation without the force."""
    sentence = sentence_of(target)
    time = observed.time_fraction
    part = {g.CONSTANT: np.ones(len(time)), g.LINEAR: time}.get(sentence.form)
    force = np.outer(time >= values[3] if part is None else part, values[:3])
    place = link_center(observed, sentence.place)
    height = place[:, 2] + observed.depth
    down = -force[:, 2]
    moment = height[:, None] * force[:, :2] + down[:, None] * (place - observed.loaded_center)[:, :2]
    return observed.changed(
        shift=observed.shift + moment / (observed.loaded_weight + down)[:, None], lift=observed.lift + down
    )
