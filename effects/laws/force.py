"""A force on a link that nobody knows of: constant in the base frame, from the start or from a time on.

The simulation ties the link's centre of mass by a soft spring to a point a kilometre away. Its removal moves
the centre of pressure by the force's moment about the floor of the cells; what pulls down is added to the
weight. The link's centre of mass is that of the nominal robot.
"""

from __future__ import annotations

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


def inject(rig: Rig, target: str, values: Values) -> Rig:
    """Return the laboratory with the force."""
    sentence, force = sentence_of(target), np.array(values[:3])
    size = float(np.linalg.norm(force))
    if size == 0:
        return rig
    anchor = upright_center(rig.robot, sentence.place) + FAR * force / size
    point = rig.robot.model.body(sentence.place).ipos.copy()
    name = f"force_{sentence.place}_{sentence.quantity}"

    def edit(spec: mujoco.MjSpec) -> None:
        spec.worldbody.add_site(name=f"{name}_anchor", pos=anchor)
        spec.body(sentence.place).add_site(name=f"{name}_hook", pos=point)
        rope = spec.add_tendon(name=name, stiffness=[size / FAR, 0.0, 0.0], springlength=[0.0, 0.0])
        rope.wrap_site(f"{name}_anchor")
        rope.wrap_site(f"{name}_hook")

    if sentence.quantity == g.NOTHING:
        return edited(rig, edit)
    return from_then_on(rig, values[3], lambda one: edited(one, edit))


def predict(observed: Observation, target: str, values: Values) -> Observation:
    """Return the observation without the force."""
    sentence = sentence_of(target)
    acts = (
        observed.time_fraction >= values[3] if sentence.quantity == g.TIME else np.ones(len(observed), bool)
    )
    force = np.outer(acts, values[:3])
    place = link_center(observed, sentence.place)
    height = place[:, 2] + observed.depth
    down = -force[:, 2]
    moment = height[:, None] * force[:, :2] + down[:, None] * (place - observed.loaded_center)[:, :2]
    return observed.changed(
        shift=observed.shift + moment / (observed.loaded_weight + down)[:, None], lift=observed.lift + down
    )
