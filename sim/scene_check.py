"""Check a scene for everything that the laboratory looks up by name, before a simulation begins."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.drives import motor_joint
from tulip_testbed.sim.model_check import check_before_compiling, check_features, check_options
from tulip_testbed.sim.plates import cell_names, plate_geometry
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.specs import compile_spec

# Attribute of the model that counts elements of a kind.
COUNTS = {"body": "nbody", "geom": "ngeom", "site": "nsite", "sensor": "nsensor", "joint": "njnt"}


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
