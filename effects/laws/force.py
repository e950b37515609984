"""A force on a link that nobody knows of: constant in the base frame, from the start or from a time on.

The simulation ties the link's centre of mass by a soft spring to a point a kilometre away. Its removal moves
the centre of pressure by the force's moment about the floor of the cells; what pulls down is added to the
weight. The link's centre of mass is that of the nominal robot.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.catalogue.tether import FAR, UPRIGHT
from tulip_testbed.effects.effect import Values
from tulip_testbed.effects.injection import edited, from_then_on
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import sentence_of
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, sole_point

AXES = ("x", "y", "z")


def inject(rig: Rig, target: str, values: Values) -> Rig:
    """Return the laboratory with the force."""
    sentence, force = sentence_of(target), np.array(values[:3])
    size = float(np.linalg.norm(force))
    if size == 0:
        return rig
    anchor = _upright(rig.robot, sentence.place) + FAR * force / size
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
    place = _center_of(observed, sentence.place)
    height = place[:, 2] + observed.depth
    down = -force[:, 2]
    moment = height[:, None] * force[:, :2] + down[:, None] * (place - observed.loaded_center)[:, :2]
    return observed.changed(
        shift=observed.shift + moment / (observed.loaded_weight + down)[:, None], lift=observed.lift + down
    )


def _center_of(observed: Observation, link: str) -> np.ndarray:
    """Compute the nominal centre of mass of a link in the base frame, (m, 3) [m]."""
    rotations, positions = observed.frames
    frame = observed.tree.frame(link)
    own = observed.nominal.robot.model.body(link).ipos
    return positions[:, frame] + rotations[:, frame] @ own


def _upright(robot: Robot, link: str) -> np.ndarray:
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
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ (data.body(link).xipos - sole)
