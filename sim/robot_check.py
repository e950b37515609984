"""Findings on a robot and its scene before a simulation: what will go wrong, and what is assumed instead."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed, warn
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.control import joint_torques
from tulip_testbed.sim.drives import (
    LEAST_ARMATURE,
    SOLIMP_FRICTION,
    SOLREF_FRICTION,
    motor_joint,
    short_of_armature,
    soft_friction,
)
from tulip_testbed.sim.model_check import check_before_compiling, check_features, check_options
from tulip_testbed.sim.plates import cell_names, plate_geometry
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import STAND, Robot, joint_names, sole_point, standing
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.specs import compile_spec

# Attribute of the model that counts elements of a kind.
COUNTS = {"body": "nbody", "geom": "ngeom", "site": "nsite", "sensor": "nsensor", "joint": "njnt"}
SINGULAR = 1e-3  # smallest singular value of a leg's Jacobian over its largest: straight
MOST_NAMED = 4  # joints in a finding


def check_scene(rig: Rig) -> None:
    """Refuse a scene in which the robot cannot be held."""
    where = str(rig.robot.scene_file or rig.robot.model_file)
    nominal = rig.robot.model
    try:
        spec = laboratory_scene(rig, np.zeros((2, 3)))
        for plate in PLATES:
            plate_geometry(spec, plate)
    except InputError as error:
        raise InputError(str(error) if where in str(error) else f"{where}: {error}") from None
    check_before_compiling(spec, where)
    model = compile_spec(spec, where)
    check_options(model, where)
    check_features(model, where)
    soles = rig.robot.sole_geoms
    for kind, names in (
        ("body", [*rig.robot.feet, *(f"{plate}_plate" for plate in PLATES)]),
        ("geom", ["floor", *soles, *cell_names()]),
        ("site", cell_names()),
        ("sensor", cell_names()),
        ("joint", joint_names(nominal)),
    ):
        _require_names(
            where, kind, names, (getattr(model, kind)(i).name for i in range(getattr(model, COUNTS[kind])))
        )
    for name in cell_names():
        if (found := mujoco.mjtSensor(int(model.sensor(name).type[0]))) != mujoco.mjtSensor.mjSENS_TOUCH:
            raise InputError(f"{where}: sensor '{name}': found {found.name}, expected a touch sensor")
        if cutoff := float(model.sensor(name).cutoff[0]):
            raise InputError(f"{where}: sensor '{name}': found a cutoff of {cutoff:g} N, expected none")
    _check_drives(where, model, joint_names(nominal))
    _check_pairs(model, nominal.body(1).name, soles, where)


def _check_drives(where: str, model: mujoco.MjModel, joints: tuple[str, ...]) -> None:
    driven = {}
    for i in range(model.nu):
        actuator = model.actuator(i).name
        if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT:
            raise InputError(f"{where}: actuator '{actuator}': found no joint that it drives, expected one")
        if not 0 < model.actuator_forcerange[i, 1] < np.inf:
            raise InputError(f"{where}: actuator '{actuator}': found no forcerange, expected a torque limit")
        joint = model.joint(model.actuator_trnid[i, 0]).name
        if joint in driven:
            raise InputError(f"{where}: joint '{joint}': found two actuators, expected one")
        driven[joint] = actuator
    motors = {joint for joint in joints if motor_joint(model, joint) in driven}
    _require_names(where, "actuator for joint", joints, motors)
    for joint in joints:
        if model.joint(joint).type[0] != mujoco.mjtJoint.mjJNT_HINGE:
            raise InputError(f"{where}: joint '{joint}': found no hinge, expected one as in the robot alone")


def _check_pairs(model: mujoco.MjModel, robot: str, soles: tuple[str, ...], where: str) -> None:
    """Refuse contact pairs of the robot other than those of its sole corners with something else.

    Such a contact would bear forces that no plate reads.
    """
    root = model.body(robot).id
    for k in range(model.npair):
        geoms = [int(model.pair_geom1[k]), int(model.pair_geom2[k])]
        own = [model.geom(g).name for g in geoms if model.body_rootid[model.geom_bodyid[g]] == root]
        if len(own) > 1 or any(name not in soles for name in own):
            names = " and ".join(f"'{model.geom(g).name}'" for g in geoms)
            raise InputError(
                f"{where}: <contact>: found a pair of {names}, expected the robot in pairs of a sole corner "
                "and its board alone: remove it"
            )


def _require_names(where: str, kind: str, wanted: Iterable[str], names: Iterable[str]) -> None:
    there = set(names)
    if missing := [name for name in wanted if name not in there]:
        raise InputError(
            f"{where}: found no {kind} '{missing[0]}' ({len(missing)} missing: {listed(missing)})"
        )


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
        return f"found {self.found}: {self.consequence}; {self.assumed}"


def robot_findings(robot: Robot) -> Iterator[RobotFinding]:
    """Yield what will go wrong with a robot in the laboratory, without simulating anything.

    Nothing is found if the robot meets every need (docs/how-to/your-robot.md lists them).
    """
    try:
        torques = joint_torques(robot.spec)
    except InputError as error:
        yield RobotFinding(
            "drives",
            str(error).partition("found ")[2] or str(error),
            "no laboratory can be built",
            "give every motor a torque limit in both directions",
        )
    else:
        yield from _of_drives(robot, torques)
    yield from _of_start(robot)


@lru_cache(maxsize=32)
def warn_of_robot(robot: Robot) -> None:
    """Warn of every finding on a robot, once for each robot that was loaded."""
    for finding in robot_findings(robot):
        warn(f"{robot.model_file}: {finding.sentence}")


def _of_drives(robot: Robot, torques: dict[str, float]) -> Iterator[RobotFinding]:
    if without := [name for name in joint_names(robot.model) if name not in torques]:
        yield RobotFinding(
            "motors",
            f"no motor with a torque limit on {_some(without)}",
            "no laboratory can be built",
            "give each joint one, or remove the joint, which fixes its body to the one above",
        )
    if short := short_of_armature(robot.spec):
        joints = _some([f"{name} ({found:.2g} of {needed:.2g})" for name, (found, needed) in short.items()])
        yield RobotFinding(
            "armature",
            f"an armature below {LEAST_ARMATURE:g} kg m2 per Nm of torque limit in {joints}",
            "their servos would chatter",
            "the laboratory raises it to that in its scene",
        )
    if soft := soft_friction(robot.spec):
        solref, solimp = (" ".join(map("{:g}".format, x)) for x in (SOLREF_FRICTION, SOLIMP_FRICTION[:3]))
        yield RobotFinding(
            "friction",
            f'frictionloss softer than solreffriction="{solref}" solimpfriction="{solimp}" in {_some(soft)}',
            "these joints would creep for long before they stick",
            "the laboratory sets these numbers in its scene",
        )


def _of_start(robot: Robot) -> Iterator[RobotFinding]:
    there = STAND in [robot.model.key(k).name for k in range(robot.model.nkey)]
    straight = _some(_straight_legs(robot, standing(robot.model)))
    if not there:
        legs = f" with straight legs ({straight}) and may find few postures or none" if straight else ""
        yield RobotFinding(
            "stand",
            f"no keyframe '{STAND}'",
            f"inverse kinematics starts from the model's zero posture{legs}",
            "the zero posture is assumed: a keyframe with bent knees is safer",
        )
    elif straight:
        yield RobotFinding(
            "stand",
            f"straight legs ({straight}) in the keyframe '{STAND}'",
            "inverse kinematics starts at a singular posture and may find few postures or none",
            "the keyframe is used as it is: bend its knees",
        )


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
