"""Effects of the robot's surroundings and of the procedure: the floor, ropes, the wait after a move."""

from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import always, edited
from tulip_testbed.effects.lasting import Lasting
from tulip_testbed.effects.ropes import FAR, hook, link_center, tie, without_force
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.dynamics.hold import CONTROL_PERIOD
from tulip_testbed.sim.rig import Rig


def _tilt(rig: Rig, target: str, values: Values) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        # The floor is rotated about the level x, then the level y: in its axes gravity rotates back.
        back = Rotation.from_euler("xy", values).inv()
        spec.option.gravity = back.apply(spec.option.gravity)

    return edited(rig, edit)


def _level(observed: Observation, target: str, values: Values) -> Observation:
    return _level_by(observed, *np.transpose([values]))


def _level_by(observed: Observation, about_x: np.ndarray, about_y: np.ndarray) -> Observation:
    """Return the observation on a level floor, of one tilted in every row or alike in all [rad]."""
    slope = np.column_stack([np.tan(about_y) / np.cos(about_x), -np.tan(about_x)])
    normal = np.cos(about_x) * np.cos(about_y)
    return observed.changed(
        shift=observed.shift + observed.height[:, None] * slope,
        lift=observed.lift + observed.loaded_weight * (normal - 1),
        push=observed.push - slope,
    )


def _yield_to_load(rig: Rig, target: str, values: Values) -> Rig:
    def softer(one: Rig) -> Rig:
        about_x, about_y = np.add(one.floor, values).tolist()
        return replace(one, floor=(about_x, about_y))

    return always(rig, softer)


def _unyielding(observed: Observation, target: str, values: Values) -> Observation:
    about_x, about_y = values
    down, point = observed.foot_loads
    x, y = (down[..., None] * point).sum(axis=1).T
    return _level_by(observed, -about_x * y, about_y * x)


def _pull(rig: Rig, target: str, values: Values) -> Rig:
    force = float(np.linalg.norm(values))
    if force == 0:
        return rig
    hooked, reach = hook(rig.robot), FAR * np.append(np.array(values) / force, 0.0)
    return edited(rig, lambda spec: tie(spec, "tether", hooked, reach, force / FAR, 0.0))


def _without_pull(observed: Observation, target: str, values: Values) -> Observation:
    return without_force(observed, observed.tree.links[0], np.array(values))


def _lift(rig: Rig, target: str, values: Values) -> Rig:
    if values[0] == 0:
        return rig
    hooked, reach = hook(rig.robot), FAR * np.array([0.0, 0.0, 1.0])
    return edited(rig, lambda spec: tie(spec, "hoist", hooked, reach, values[0] / FAR, 0.0))


def _without_lift(observed: Observation, target: str, values: Values) -> Observation:
    return without_force(observed, observed.tree.links[0], np.array([0.0, 0.0, values[0]]))


def _hold(rig: Rig, target: str, values: Values) -> Rig:
    hooked = hook(rig.robot)

    def edit(spec: mujoco.MjSpec) -> None:
        for name, way in zip("xy", np.eye(3), strict=False):
            tie(spec, f"tether_spring_{name}", hooked, FAR * way, values[0], FAR)

    return rig if values[0] == 0 else edited(rig, edit)


def _without_spring(observed: Observation, target: str, values: Values) -> Observation:
    torso = observed.tree.links[0]
    away = link_center(observed, torso)[:, :2] - hook(observed.nominal.robot).upright[:2]
    return without_force(observed, torso, -values[0] * away)


def _read_early(rig: Rig, target: str, values: Values) -> Rig:
    def sooner(one: Rig) -> Rig:
        hasty = replace(
            one.protocol,
            hold_time=one.protocol.window + values[0],
            speed_gate=np.inf,
            force_gate=np.inf,
            calm_time=CONTROL_PERIOD,
            gated=False,
        )
        return replace(one, protocol=hasty)

    return always(rig, sooner)


EFFECTS = (
    Effect(
        name="tilt",
        sentence="The floor is tilted with robot and plates, about x, then about y; gravity stays vertical.",
        parameters=(
            Parameter("about x", "rad", prior=np.radians(1.0)),
            Parameter("about y", "rad", prior=np.radians(1.0)),
        ),
        mechanism=Physics(_tilt, _level),
        words="The floor is tilted by {0} (left side up) and {1} (front down).",
        lasting=Lasting(until="session", of_room=True),
        explanation="""The floor is not level: robot and plates are tilted with it, gravity stays vertical.

        The cells measure along the floor's normal. In the floor's axes gravity is tilted, so the centre of
        pressure lies downhill of the centre of mass, by its height over the cells times the slope.
        """,
    ),
    Effect(
        name="floor-compliance",
        sentence="The floor under both plates yields to the side of the load.",
        parameters=(
            Parameter("about x", "rad/Nm", prior=np.radians(0.01), positive=True),
            Parameter("about y", "rad/Nm", prior=np.radians(0.01), positive=True),
        ),
        mechanism=Physics(_yield_to_load, _unyielding),
        words="The floor yields by {0} about x and {1} about y.",
        lasting=Lasting(until="session", of_room=True),
        explanation="""The floor turns with robot and plates to the side where the load is.

        Robot and plates keep their places on the floor, so that encoders and cells see only how gravity turns
        in its axes. Moments are those of the cells' forces about the foot that carries the base frame. A turn
        by the weight alone is a constant tilt, which is an effect of its own. The simulation turns gravity as
        the cells are loaded.
        """,
    ),
    Effect(
        name="tether",
        sentence="Something pulls horizontally at the torso's centre of mass with a constant force "
        "(base frame).",
        parameters=(Parameter("x", "N", prior=2.0), Parameter("y", "N", prior=2.0)),
        mechanism=Physics(_pull, _without_pull),
        words="Something pulls at the torso with {0} forwards and {1} to the left.",
        lasting=Lasting(until="cable", of_room=True),
        explanation="""A cable or hoist pulls the torso sideways, with the same force in all postures.

        The simulation ties the torso's centre of mass by a soft spring to a point a kilometre away. The force
        is given in the base frame. Its moment about the floor of the cells shifts the centre of pressure.
        """,
    ),
    Effect(
        name="hoist",
        sentence="Something carries a part of the robot's weight, at the torso's centre of mass.",
        parameters=(Parameter("force", "N", prior=5.0, positive=True),),
        mechanism=Physics(_lift, _without_lift),
        words="Something lifts the torso with {0}.",
        lasting=Lasting(until="cable"),
        explanation="""A hoist or a stiff cable carries a part of the weight, the same in all postures.

        The simulation ties the torso's centre of mass by a soft spring to a point a kilometre above. To the
        centre of pressure it is as if the torso had less mass: only the sum of the cells against the weighed
        mass shows it, as it shows a gain that all cells share. Look at the rope.
        """,
    ),
    Effect(
        name="tether-spring",
        sentence="Something pulls the torso back horizontally to its place in upright standing, "
        "like a spring.",
        parameters=(Parameter("stiffness", "N/m", prior=20.0, positive=True),),
        mechanism=Physics(_hold, _without_spring),
        words="Something pulls the torso back to its place in upright standing like a spring of {0}.",
        lasting=Lasting(until="cable"),
        explanation="""A cable or hoist pulls the torso back, the more the further it moves: a hanging cable.

        Two springs act at the torso's centre of mass, forwards and to the left in the base frame. They have
        no slack, and no force where the torso is in the keyframe `stand`. Their other ends are a kilometre
        away.
        """,
    ),
    Effect(
        name="unsettled",
        sentence="The robot is read this long after its release, whether it has come to rest or not.",
        parameters=(Parameter("settling", "s", prior=2.0, positive=True),),
        mechanism=Physics(_read_early, lambda observed, target, values: observed),
        words="The robot was read {0} after its release.",
        statics=False,
        explanation="""The robot is read before it has come to rest: the wait after every move is too short.

        The simulation reads a full window that begins this time after the robot is released, or when dry
        friction first holds the load if that is later, whether the robot rests or not. A robot that creeps is
        in equilibrium at every moment, and angles and cells are averaged over the same window, so no residual
        shows the creep. A swaying robot shifts the mean centre of pressure only by its mean horizontal
        acceleration over the window, times height over gravity. So nothing is removed from an observation:
        only the standard deviation of the readings within a window shows the effect.
        """,
    ),
)
