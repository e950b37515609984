"""Effects on the masses and the lengths of links."""

from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import STARTS, add_mass, edited, from_then_on
from tulip_testbed.effects.ropes import link_center, loaded
from tulip_testbed.effects.targets import LEG_LINKS, LINKS, lengthenings
from tulip_testbed.identification.kinematics import tree_of
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def _load(rig: Rig, target: str, values: Values) -> Rig:
    mass, *place = values
    return edited(rig, lambda spec: add_mass(spec, target, mass, np.array(place)))


def _load_later(rig: Rig, target: str, values: Values) -> Rig:
    mass, start = values

    def edit(spec: mujoco.MjSpec) -> None:
        add_mass(spec, target, mass, rig.robot.model.body(target).ipos.copy())

    return from_then_on(rig, start, lambda one: edited(one, edit))


def _unloaded(observed: Observation, target: str, values: Values) -> Observation:
    mass, start = values
    down = mass * (observed.time_fraction >= start) * observed.measurements.gravity
    moment = down[:, None] * (link_center(observed, target) - observed.loaded_center)[:, :2]
    return loaded(observed, moment, down)


def _lengthen(rig: Rig, target: str, values: Values) -> Rig:
    tree = tree_of(rig.robot.model)

    def edit(spec: mujoco.MjSpec) -> None:
        for number, way in lengthenings(rig.robot)[target]:
            body = spec.joint(tree.joints[tree.edges[number].joint]).parent
            body.pos = body.pos + values[0] * way

    return edited(rig, edit)


def _with_true_length(observed: Observation, target: str, values: Values) -> Observation:
    edges = list(observed.tree.edges)
    for number, way in lengthenings(observed.nominal.robot)[target]:
        anchor = edges[number].anchor + values[0] * np.array([way, np.zeros(3)])
        edges[number] = replace(edges[number], anchor=anchor)
    return observed.changed(tree=observed.tree.with_lengths(tuple(edges)))


EFFECTS = (
    Effect(
        name="payload",
        sentence="A mass is fixed to a link, and the robot was weighed with it (link's frame).",
        parameters=(
            Parameter("mass", "kg", prior=0.5, positive=True),
            *(Parameter(axis, "m", prior=0.1) for axis in "xyz"),
        ),
        mechanism=Physics(_load, lambda observed, target, values: observed),
        words="The {target} link carries {0} more, at ({1}, {2}, {3}) in its frame.",
        targets=LINKS,
        explanation="""A mass that the model lacks is fixed to a link: a battery, a head or a hanging arm.

        The base parameters absorb it completely: the scale weighs the robot with the payload, the identified
        parameters are those of the loaded robot, and no residual shows anything. So nothing is removed from
        an observation. The parameters differ from those of the robot without the payload.
        """,
    ),
    Effect(
        name="payload-step",
        sentence="From some time on a link carries an additional mass at its nominal centre of mass.",
        parameters=(Parameter("mass", "kg", prior=0.5), Parameter("start", "", grid=STARTS)),
        mechanism=Physics(_load_later, _unloaded),
        words="The {target} link carries {0} more from {1} of the experiment's time on.",
        targets=LINKS,
        explanation="""A mass is added at a link's nominal centre of mass: a forgotten tool or a hanging
        cable.

        The robot was weighed before. From then on the cells also bear the mass, and the centre of pressure
        moves towards that point by the ratio of the mass to the total mass.
        """,
    ),
    Effect(
        name="link-length",
        sentence="A link between the feet is longer than nominal, from joint to joint.",
        parameters=(Parameter("length", "m", prior=0.002),),
        mechanism=Physics(_lengthen, _with_true_length),
        words="From joint to joint the {target} link is {0} longer than in its drawing.",
        targets=LEG_LINKS,
        explanation="""A link is longer than in the drawing, from its joint to the next one. The link that
        bears both legs is wider: both hips are off by half of it. Only joints between the feet count.

        The closure of the legs shows it. In the centre of pressure it cannot be seen: the base parameters
        absorb it together with the masses beyond the link.
        """,
    ),
)
