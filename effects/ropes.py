"""A force on a link: simulated by a rope, a spring whose other end is far away, and removed by its moment."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.robot import Robot, sole_point, standing

FAR = 1000.0  # m, to the other ends of ropes: the torso moves too little to change their force or direction


@dataclass(frozen=True)
class Hook:
    """The centre of mass of a nominal link, where ropes are tied.

    Attributes:
        body: name of the link.
        point: in the link's frame, (3,) [m].
        upright: in the base frame, in the keyframe `stand` or otherwise at zero angles, (3,) [m].
    """

    body: str
    point: np.ndarray
    upright: np.ndarray


def hook(robot: Robot, link: str = "") -> Hook:
    """Find the centre of mass of a link, by default of the torso."""
    model = robot.model
    link = link or model.body(1).name
    data = mujoco.MjData(model)
    data.qpos[:] = standing(model)
    mujoco.mj_kinematics(model, data)
    foot = data.body(robot.stance_foot)
    turn = foot.xmat.reshape(3, 3)
    sole = foot.xpos + turn @ sole_point(model, robot.stance_foot)
    yaw = np.arctan2(turn[1, 0], turn[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    to_base = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return Hook(link, model.body(link).ipos.copy(), to_base @ (data.body(link).xipos - sole))


def tie(
    spec: mujoco.MjSpec, name: str, hooked: Hook, reach: np.ndarray, stiffness: float, length: float
) -> None:
    """Tie a link by a spring [N/m] of a length at rest [m] to a point, `reach` [m] from its place, (3,)."""
    spec.worldbody.add_site(name=f"{name}_anchor", pos=hooked.upright + reach)
    spec.body(hooked.body).add_site(name=f"{name}_hook", pos=hooked.point)
    rope = spec.add_tendon(name=name, stiffness=[stiffness, 0.0, 0.0], springlength=[length, length])
    rope.wrap_site(f"{name}_anchor")
    rope.wrap_site(f"{name}_hook")


def link_center(observed: Observation, link: str) -> np.ndarray:
    """Compute the nominal centre of mass of a link in the base frame, (m, 3) [m]."""
    rotations, positions = observed.geometry.frames
    frame = observed.tree.frame(link)
    return positions[:, frame] + rotations[:, frame] @ observed.nominal.robot.model.body(link).ipos


def without_force(observed: Observation, link: str, force: np.ndarray) -> Observation:
    """Remove a force at a link's nominal centre of mass from an observation.

    Its moment about the plane of the readings shifts the centre of pressure; what pulls down adds to the
    weight.

    Args:
        force: in the base frame, horizontal, (m, 2) or (2,), or of any direction, (m, 3) or (3,) [N].
    """
    place, weight = link_center(observed, link), observed.loaded_weight
    push = observed.push - force[..., :2] / weight[:, None]
    moment = (place[:, 2] + observed.depth)[:, None] * force[..., :2]
    down = -force[..., 2] * np.ones(len(observed)) if force.shape[-1] == 3 else np.zeros(len(observed))
    moment = moment + down[:, None] * (place - observed.loaded_center)[:, :2]
    return loaded(observed, moment, down).changed(push=push)


def loaded(observed: Observation, moment: np.ndarray, down: np.ndarray) -> Observation:
    """Return the observation without a load, in addition to what was removed before.

    The shift is the moment of all loads, in any order, over all that the contacts bear.

    Args:
        moment: of the load about the centre of mass, (m, 2) [Nm]. down: its vertical force, (m,) [N].
    """
    before = observed.weight + observed.lift
    shift = (before[:, None] * observed.shift + moment) / (before + down)[:, None]
    return observed.changed(shift=shift, lift=observed.lift + down)
