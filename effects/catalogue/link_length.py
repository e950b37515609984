"""A link is longer than in the drawing, from its joint to the next one.

The closure of the legs shows it. In the centre of pressure it cannot be seen: the base parameters absorb it
together with the masses beyond the link.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.targets import LEG_LINKS, next_joint
from tulip_testbed.identification.kinematics import tree_of
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    tree = tree_of(rig.robot.model)
    number, way = next_joint(tree, target)
    joint = tree.joints[tree.edges[number].joint]

    def edit(spec: mujoco.MjSpec) -> None:
        body = spec.joint(joint).parent
        body.pos = body.pos + values[0] * way / np.linalg.norm(way)

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    number, way = next_joint(observed.tree, target)
    edge = observed.tree.edges[number]
    anchor = edge.anchor.copy()
    anchor[0] += values[0] * way / np.linalg.norm(way)
    edges = list(observed.tree.edges)
    edges[number] = replace(edge, anchor=anchor)
    return replace(observed, tree=replace(observed.tree, edges=tuple(edges)))


EFFECT = Effect(
    name="link-length",
    sentence="A link between the feet is longer than nominal, from its joint to the next.",
    parameters=(Parameter("length", "m", prior=0.002),),
    mechanism=Physics(_inject, _predict),
    words="The {target} link is {0} longer than in its drawing.",
    targets=LEG_LINKS,
)
