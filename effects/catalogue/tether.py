"""A cable or hoist pulls the torso sideways, with the same force in all postures.

The simulation ties the torso's centre of mass by a soft spring to a point a kilometre away. The force is
given in the base frame. Its moment about the floor of the cells shifts the centre of pressure.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, sole_point

FAR = 1000.0  # m, to the other ends of ropes: the torso moves too little to change their force or direction
UPRIGHT = "stand"


@dataclass(frozen=True)
class Hook:
    """The centre of mass of the nominal torso, where ropes are tied.

    Attributes:
        body: name of the torso.
        point: in the torso's frame, (3,) [m].
        upright: in the base frame, in the keyframe `stand` or otherwise at zero angles, (3,) [m].
    """

    body: str
    point: np.ndarray
    upright: np.ndarray


def hook(robot: Robot) -> Hook:
    """Find the centre of mass of a robot's torso."""
    torso = robot.model.body(1)
    return Hook(torso.name, torso.ipos.copy(), upright_center(robot, torso.name))


def upright_center(robot: Robot, link: str) -> np.ndarray:
    """Return the centre of mass of a link of the standing robot in the base frame, (3,) [m]."""
    model = robot.model
    data = mujoco.MjData(model)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, UPRIGHT)
    if key >= 0:
        mujoco.mj_resetDataKeyframe(model, data, key)
    mujoco.mj_kinematics(model, data)
    foot = data.body(robot.stance_foot)
    turn = foot.xmat.reshape(3, 3)
    sole = foot.xpos + turn @ sole_point(model, robot.stance_foot)
    yaw = np.arctan2(turn[1, 0], turn[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    to_base = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return to_base @ (data.body(link).xipos - sole)


def tie(
    spec: mujoco.MjSpec, name: str, hooked: Hook, way: np.ndarray, stiffness: float, length: float
) -> None:
    """Tie the torso to a point far away by a spring.

    Args:
        way: horizontal unit vector to that point, (2,).
        stiffness: of the spring [N/m].
        length: of the spring at rest [m].
    """
    anchor = hooked.upright + FAR * np.append(way, 0.0)
    spec.worldbody.add_site(name=f"{name}_anchor", pos=anchor)
    spec.body(hooked.body).add_site(name=f"{name}_hook", pos=hooked.point)
    rope = spec.add_tendon(name=name, stiffness=[stiffness, 0.0, 0.0], springlength=[length, length])
    rope.wrap_site(f"{name}_anchor")
    rope.wrap_site(f"{name}_hook")


def torso_center(observed: Observation) -> np.ndarray:
    """Compute the nominal torso's centre of mass in the base frame, (m, 3) [m]."""
    return link_center(observed, observed.tree.links[0])


def link_center(observed: Observation, link: str) -> np.ndarray:
    """Compute the nominal centre of mass of a link in the base frame, (m, 3) [m]."""
    rotations, positions = observed.frames
    frame = observed.tree.frame(link)
    return positions[:, frame] + rotations[:, frame] @ observed.nominal.robot.model.body(link).ipos


def without_pull(observed: Observation, force: np.ndarray) -> Observation:
    """Remove a horizontal force at the torso's centre of mass from an observation.

    Args:
        force: in the base frame, (m, 2) or (2,) [N].
    """
    height = torso_center(observed)[:, 2] + observed.depth
    return observed.changed(shift=observed.shift + height[:, None] * force / observed.loaded_weight[:, None])


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    force = float(np.linalg.norm(values))
    if force == 0:
        return rig
    hooked, way = hook(rig.robot), np.array(values) / force

    def edit(spec: mujoco.MjSpec) -> None:
        tie(spec, "tether", hooked, way, force / FAR, 0.0)

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return without_pull(observed, np.array(values))


EFFECT = Effect(
    name="tether",
    sentence="Something pulls horizontally at the torso's centre of mass with a constant force (base frame).",
    parameters=(Parameter("x", "N", prior=2.0), Parameter("y", "N", prior=2.0)),
    mechanism=Physics(_inject, _predict),
    words="Something pulls at the torso with {0} forwards and {1} to the left.",
)
