"""Specs (MjSpec): read from a file, without meshes that only a viewer needs, compiled."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, shortened

T = TypeVar("T")
# Exceptions of MuJoCo's compiler.
BROKEN = (ValueError, RuntimeError, mujoco.FatalError, mujoco.UnexpectedError)


def read_spec(path: Path) -> mujoco.MjSpec:
    """Parse an MJCF; a free joint without a name takes that of its body."""
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        names = {joint.name for joint in spec.joints}
        for joint in spec.joints:
            if joint.type == mujoco.mjtJoint.mjJNT_FREE and not joint.name:
                body = joint.parent.name
                joint.name = body if body not in names else f"{body}_free"
    except BROKEN as error:
        raise InputError(f"{path}: broken MJCF: {shortened(error, 300)}") from None
    return spec


def without_meshes(spec: mujoco.MjSpec, where: str) -> mujoco.MjSpec:
    """Remove meshes without contacts, and make the inertias inferred from them explicit.

    A published humanoid takes a hundred times as long to compile with its meshes as without.
    """
    touching = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    unused = [
        geom
        for geom in spec.geoms
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH
        and not (geom.contype or geom.conaffinity or geom.name in touching)
    ]
    if not unused:
        return spec
    inferred = [body for body in spec.bodies[1:] if not body.explicitinertial]
    if inferred:
        model = compile_spec(spec.copy(), where)
        for body in inferred:
            k = model.body(body.name).id
            body.mass, body.ipos = model.body_mass[k], model.body_ipos[k]
            body.iquat, body.inertia = model.body_iquat[k], model.body_inertia[k]
            body.fullinertia, body.explicitinertial = np.full(6, np.nan), True
    for geom in unused:
        spec.delete(geom)
    still = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in still:
            spec.delete(mesh)
    return spec


def compile_spec(spec: mujoco.MjSpec, where: str) -> mujoco.MjModel:
    """Compile a spec; the compiler's complaint becomes the message of an `InputError`."""
    return _quietly(spec.compile, where)


def xml_of(spec: mujoco.MjSpec, where: str) -> str:
    """Return a spec as MJCF text, for which MuJoCo compiles it; see `compile_spec`."""
    return _quietly(spec.to_xml, where)


def _quietly(compiling: Callable[[], T], where: str) -> T:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `check_model` refuses these cases by name
            return compiling()
    except BROKEN as error:
        raise InputError(f"{where}: broken MJCF: {shortened(error, 300)}") from None
