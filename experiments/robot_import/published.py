"""Read a robot as people publish it: an MJCF or a URDF."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import present, read_bytes
from tulip_testbed.experiments.robot_import.skeleton import SourceFile
from tulip_testbed.experiments.robot_import.urdf import Parsed, read_urdf
from tulip_testbed.sim.control import joint_torques
from tulip_testbed.sim.mjcf_files import mjcf_files
from tulip_testbed.sim.sandbox import try_to_compile
from tulip_testbed.sim.specs import compile_spec

STANDING = ("stand", "home", "standing", "stand_bent_knees", "knees_bent", "default")  # names of keyframes
EARTH = (0.0, 0.0, -9.81)  # m/s2
LOOPS = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)


def read_published(path: Path) -> SourceFile:
    """Read a published robot.

    Raises:
        InputError: no MJCF or URDF, or closed loops.
    """
    if not present(path):
        raise InputError(f"{path}: no such file, expected an MJCF or a URDF")
    head = read_bytes(path)[:4096]
    if b"<robot" in head or path.suffix == ".urdf":
        parsed = read_urdf(path)
    elif b"<mujoco" in head or path.suffix == ".xml":
        parsed = _mjcf(path)
    else:
        kind = "an SDF" if b"<sdf" in head else f"'{path.suffix}'"
        raise InputError(f"{path}: found {kind}, expected an MJCF or a URDF")
    spec, assumed = parsed.spec, list(parsed.assumed)
    _name_all(spec)
    _try(parsed, path)
    model = compile_spec(spec, str(path))
    root = _root(model, path)
    torque = dict(joint_torques(spec))
    for j in range(model.njnt):  # a URDF's effort
        if model.jnt_actfrclimited[j]:
            name, limit = model.joint(j).name, float(model.jnt_actfrcrange[j, 1])
            if limit > 0:
                torque[name] = min(torque.get(name, np.inf), limit)
    driven = _driven(model, root, parsed.followers, assumed)
    reference = _reference(model, assumed)
    assumed += _left_out(model, root)
    return SourceFile(
        model=model,
        root=root,
        driven=driven,
        torque=torque,
        reference=reference,
        assumed=tuple(assumed),
        problems=parsed.problems,
    )


def _mjcf(path: Path) -> Parsed:
    """Parse an MJCF; meshes that are missing are removed with the geoms that show them."""
    folder = path.resolve().parents[min(2, len(path.resolve().parents) - 1)]
    files = mjcf_files(path.resolve(), folder)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"{path}: broken MJCF: {shortened(error, 300)}") from None
    there = {file.name for file in files}
    files_of = {mesh.name or Path(mesh.file).stem: mesh.file for mesh in spec.meshes if mesh.file}
    missing = {name: file for name, file in files_of.items() if Path(file).name not in there}
    problems = (f"{len(missing)} meshes are missing: {listed(missing.values())}",) if missing else ()
    unseen = [geom for geom in spec.geoms if geom.meshname in missing]
    for element in [
        *unseen,
        *(mesh for mesh in spec.meshes if (mesh.name or Path(mesh.file).stem) in missing),
    ]:
        spec.delete(element)
    loops = [equality for equality in spec.equalities if equality.type in LOOPS]
    if loops:
        names = listed(f"{loop.name1} and {loop.name2}" for loop in loops)
        raise InputError(
            f"{path}: found closed loops (<equality> {shortened(names, 200)}): statics does not determine "
            "their forces, and base parameters are those of a tree; expected a tree of hinges"
        )
    coupled = [
        name
        for equality in spec.equalities
        for name in (equality.name1, equality.name2)
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and name
    ]
    if spec.plugins:
        raise InputError(f"{path}: found plugins, expected rigid bodies alone")
    of_world = list(spec.worldbody.geoms)
    for element in [*spec.equalities, *spec.pairs, *spec.excludes, *spec.sensors, *of_world]:
        spec.delete(element)
    return Parsed(spec, frozenset(coupled), problems=problems)


def _name_all(spec: mujoco.MjSpec) -> None:
    """Name bodies and joints that have no name."""
    for kind, elements in (("body", spec.bodies[1:]), ("joint", spec.joints)):
        for k, element in enumerate(elements):
            element.name = element.name or f"{kind}_{k}"


def _try(parsed: Parsed, path: Path) -> None:
    """Compile a copy in a separate process, which a file may crash."""
    copy = parsed.spec.copy()
    with tempfile.TemporaryDirectory() as folder:
        for name, content in parsed.assets.items():
            (Path(folder) / name).write_bytes(content)
        beside = Path(folder) if parsed.assets else path.parent
        copy.compiler.meshdir = str((beside / copy.compiler.meshdir).resolve())
        copy.compiler.texturedir = str((beside / copy.compiler.texturedir).resolve())
        place = Path(folder) / f"{path.stem}.xml"
        text = copy.to_xml()
        place.write_text(text, encoding="utf-8")
        try:
            try_to_compile(place, {place: {place: hashlib.sha256(text.encode()).hexdigest()}})
        except InputError as error:
            raise InputError(str(error).replace(str(place), str(path))) from None


def _left_out(model: mujoco.MjModel, root: int) -> list[str]:
    """Say which forces of the file the prepared robot does not have."""
    own = [j for j in range(model.njnt) if int(model.body_rootid[model.jnt_bodyid[j]]) == root]
    floating = np.flatnonzero(model.body_gravcomp).tolist()
    strained = [t for t in range(model.ntendon) if np.any(model.tendon_stiffness[t])]
    forces = {
        "springs of the joints": [model.joint(j).name for j in own if np.any(model.jnt_stiffness[j])],
        "springs of the tendons": [model.tendon(t).name for t in strained],
        "compensation of the weight of": [model.body(b).name for b in floating],
    }
    lines = [f"left out: {force} {listed(names)}" for force, names in forces.items() if names]
    if not np.allclose(model.opt.gravity, EARTH):
        lines.append(f"left out: gravity {listed(model.opt.gravity)}; it is {listed(EARTH)} m/s2")
    return lines


def _root(model: mujoco.MjModel, path: Path) -> int:
    """Return the first body of the tree with the most hinges."""
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    of_hinges = model.body_rootid[model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]]
    best = max(roots, key=lambda b: int((of_hinges == b).sum()), default=0)
    if not best or best not in of_hinges:
        raise InputError(f"{path}: found no hinge joint, expected a robot on two legs")
    return best


def _driven(
    model: mujoco.MjModel, root: int, followers: frozenset[str], assumed: list[str]
) -> frozenset[str]:
    """Return the hinges that something drives; without any drive in the file, all hinges."""
    inside = (model.body_rootid[model.jnt_bodyid] == root) & (model.jnt_bodyid != root)

    def named(kind: mujoco.mjtJoint) -> list[str]:
        return [model.joint(int(j)).name for j in np.flatnonzero(inside & (model.jnt_type == kind))]

    by_joint = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
    driven = {model.joint(int(model.actuator_trnid[i, 0])).name for i in by_joint}
    every = named(mujoco.mjtJoint.mjJNT_HINGE)
    hinges = [name for name in every if name not in followers]
    for words, names in (
        ("joints that follow another one", [name for name in every if name in followers]),
        ("sliding joints", named(mujoco.mjtJoint.mjJNT_SLIDE)),
        ("ball joints", named(mujoco.mjtJoint.mjJNT_BALL)),
        ("joints that nothing drives", [name for name in hinges if driven and name not in driven]),
    ):
        if names:
            assumed.append(f"fixed: {words}: {listed(names)}")
    return frozenset(name for name in hinges if not driven or name in driven)


def _reference(model: mujoco.MjModel, assumed: list[str]) -> dict[str, float]:
    """Return the angles of a standing keyframe, or else zero, within the limits."""
    keys = [model.key(k).name for k in range(model.nkey)]
    wanted = next((name for name in STANDING if name in keys), None)
    qpos = model.qpos0 if wanted is None else model.key(wanted).qpos
    if wanted is not None:
        assumed.append(f"keyframe '{wanted}' is the start of the search for a standing posture")
    angles = {}
    for joint in map(model.joint, range(model.njnt)):
        if joint.type[0] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            value = float(qpos[joint.qposadr[0]])
            angles[joint.name] = float(np.clip(value, *joint.range)) if joint.limited[0] else value
    return angles
