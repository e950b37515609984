"""Where something pulls at the torso: its centre of mass."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.robot import Robot, sole_point

FAR = 1000.0  # m, to where ropes are tied: over the torso's ways neither their pull nor direction changes
UPRIGHT = "stand"


@dataclass(frozen=True)
class Hook:
    """The nominal torso's centre of mass.

    Attributes:
        body: its name.
        point: in the body's frame, (3,) [m].
        upright: in the base frame, in the keyframe `stand` or else at zero angles, (3,) [m].
    """

    body: str
    point: np.ndarray
    upright: np.ndarray


def hook(robot: Robot) -> Hook:
    """Of a robot's files."""
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
    return Hook(model.body(1).name, model.body_ipos[1].copy(), to_base @ (data.xipos[1] - sole))


def tie(
    spec: mujoco.MjSpec, name: str, hooked: Hook, way: np.ndarray, stiffness: float, length: float
) -> None:
    """Tie the torso to a place far away by a spring.

    Args:
        way: horizontal unit vector to that place, (2,). length: at which it is at rest [m].
    """
    anchor = hooked.upright + FAR * np.append(way, 0.0)
    spec.worldbody.add_site(name=f"{name}_anchor", pos=anchor)
    spec.body(hooked.body).add_site(name=f"{name}_hook", pos=hooked.point)
    rope = spec.add_tendon(name=name, stiffness=[stiffness, 0.0, 0.0], springlength=[length, length])
    rope.wrap_site(f"{name}_anchor")
    rope.wrap_site(f"{name}_hook")


def torso_place(observed: Observation) -> np.ndarray:
    """The torso's centre of mass in the base frame, (m, 3) [m]."""
    rotations, positions = observed.frames
    frame = observed.tree.frame_of_link[0]
    return positions[:, frame] + rotations[:, frame] @ (observed.standard[0, 1:] / observed.standard[0, 0])


def pulled(observed: Observation, force: np.ndarray) -> Observation:
    """What was observed, freed of a horizontal force on the torso, (m, 2) or (2,) [N].

    Its moment about the cells' floor shifts the centre of pressure by its height over them.
    """
    height = torso_place(observed)[:, 2] + observed.measurements.top_height[0]
    return observed.changed(shift=observed.shift + height[:, None] * force / observed.weight)
