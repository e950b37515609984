"""Findings on a robot: what will go wrong in the laboratory, and what is assumed instead."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, warn
from tulip_testbed.sim.control import joint_torques
from tulip_testbed.sim.drives import (
    LEAST_ARMATURE,
    SOLIMP_FRICTION,
    SOLREF_FRICTION,
    short_of_armature,
    soft_friction,
)
from tulip_testbed.sim.robot import STAND, Robot, joint_names, sole_point

SINGULAR = 1e-3  # smallest singular value of a leg's Jacobian over its largest: straight
MOST_NAMED = 4  # joints in a finding


@dataclass(frozen=True)
class RobotFinding:
    """A need of the laboratory that a robot does not meet.

    Attributes:
        name: what it is about, in one or two words.
        found: what was found.
        consequence: what will go wrong.
        assumed: what the laboratory does about it.
    """

    name: str
    found: str
    consequence: str
    assumed: str

    @property
    def sentence(self) -> str:
        """Return the finding in one sentence."""
        return f"found {self.found}: {self.consequence}; {self.assumed}"


def robot_findings(robot: Robot) -> tuple[RobotFinding, ...]:
    """Find what will go wrong with a robot in the laboratory, without simulating anything.

    Returns:
        the findings; none if the robot meets every need (docs/how-to/your-robot.md lists them).
    """
    try:
        torques = joint_torques(robot.spec)
    except InputError as error:
        fault = RobotFinding(
            "drives",
            str(error).partition("found ")[2] or str(error),
            "no laboratory can be built",
            "give every motor a torque limit in both directions",
        )
        return (fault, *_start(robot))
    return (*_undriven(robot, torques), *_armature(robot), *_friction(robot), *_start(robot))


@lru_cache(maxsize=32)
def warn_of_robot(robot: Robot) -> None:
    """Warn of every finding on a robot, once for each robot that was loaded."""
    for finding in robot_findings(robot):
        warn(f"{robot.model_file}: {finding.sentence}")


def _undriven(robot: Robot, torques: dict[str, float]) -> list[RobotFinding]:
    if not (without := [name for name in joint_names(robot.model) if name not in torques]):
        return []
    return [
        RobotFinding(
            "motors",
            f"no motor with a torque limit on {_some(without)}",
            "no laboratory can be built",
            "give each joint one, or remove the joint, which fixes its body to the one above",
        )
    ]


def _armature(robot: Robot) -> list[RobotFinding]:
    if not (short := short_of_armature(robot.spec)):
        return []
    joints = _some([f"{name} ({found:.2g} of {needed:.2g})" for name, (found, needed) in short.items()])
    return [
        RobotFinding(
            "armature",
            f"an armature below {LEAST_ARMATURE:g} kg m2 per Nm of torque limit in {joints}",
            "their servos would chatter",
            "the laboratory raises it to that in its scene",
        )
    ]


def _friction(robot: Robot) -> list[RobotFinding]:
    if not (soft := soft_friction(robot.spec)):
        return []
    stiff = f'solreffriction="{_numbers(SOLREF_FRICTION)}" solimpfriction="{_numbers(SOLIMP_FRICTION[:3])}"'
    return [
        RobotFinding(
            "friction",
            f"frictionloss softer than {stiff} in {_some(soft)}",
            "these joints would creep for long before they stick",
            "the laboratory sets these numbers in its scene",
        )
    ]


def _start(robot: Robot) -> list[RobotFinding]:
    """Judge where inverse kinematics starts."""
    model = robot.model
    keys = [model.key(k).name for k in range(model.nkey)]
    if STAND not in keys:
        straight = _straight_legs(robot, model.qpos0)
        legs = (
            f" with straight legs ({_some(straight)}) and may find few postures or none" if straight else ""
        )
        return [
            RobotFinding(
                "stand",
                f"no keyframe '{STAND}'",
                f"inverse kinematics starts from the model's zero posture{legs}",
                "the zero posture is assumed: a keyframe with bent knees is safer",
            )
        ]
    if straight := _straight_legs(robot, model.key(STAND).qpos):
        return [
            RobotFinding(
                "stand",
                f"straight legs ({_some(straight)}) in the keyframe '{STAND}'",
                "inverse kinematics starts at a singular posture and may find few postures or none",
                "the keyframe is used as it is: bend its knees",
            )
        ]
    return []


def _straight_legs(robot: Robot, qpos: np.ndarray) -> list[str]:
    """List the feet whose joints cannot move them in all the directions that they could when bent."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    out = []
    for name in robot.feet:
        foot = model.body(name).id
        place, jacobian = np.zeros(3), np.zeros((6, model.nv))
        mujoco.mju_rotVecQuat(place, sole_point(model, name), data.xquat[foot])
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], data.xpos[foot] + place, foot)
        leg = jacobian[:, 6:][:, np.abs(jacobian[:, 6:]).any(axis=0)]
        if leg.size:
            values = np.linalg.svd(leg, compute_uv=False)
            out += [name] if values[-1] / values[0] < SINGULAR else []
    return out


def _some(names: list[str]) -> str:
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
