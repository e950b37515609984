"""Read a robot as people publish it: an MJCF or a URDF."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import present, read_bytes
from tulip_testbed.experiments.robot_import.skeleton import Source
from tulip_testbed.experiments.robot_import.urdf import Parsed, read_urdf
from tulip_testbed.sim.control import joint_torques
from tulip_testbed.sim.mjcf_files import mjcf_files
from tulip_testbed.sim.sandbox import try_to_compile
from tulip_testbed.sim.specs import compile_spec

STANDING = ("stand", "home", "standing", "stand_bent_knees", "knees_bent", "default")  # names of keyframes
EARTH = (0.0, 0.0, -9.81)  # m/s2
LOOPS = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)


def read_published(path: Path) -> Source:
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
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return Source(
        model=model,
        root=root,
        driven=driven,
        torque=torque,
        reference=reference,
        collides=collides,
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
    problems = ()
    if missing:
        problems = (f"{len(missing)} meshes are missing: {listed(missing.values())}",)
        for geom in [one for one in spec.geoms if one.meshname in missing]:
            spec.delete(geom)
        for mesh in [one for one in spec.meshes if (one.name or Path(one.file).stem) in missing]:
            spec.delete(mesh)
    loops = [one for one in spec.equalities if one.type in LOOPS]
    if loops:
        names = listed(f"{one.name1} and {one.name2}" for one in loops)
        raise InputError(
            f"{path}: found closed loops (<equality> {shortened(names, 200)}): statics does not determine "
            "their forces, and base parameters are those of a tree; expected a tree of hinges"
        )
    coupled = [
        name
        for one in spec.equalities
        for name in (one.name1, one.name2)
        if one.type == mujoco.mjtEq.mjEQ_JOINT and name
    ]
    if spec.plugins:
        raise InputError(f"{path}: found plugins, expected rigid bodies alone")
    for kind in ("equalities", "pairs", "excludes", "sensors"):
        for one in list(getattr(spec, kind)):
            spec.delete(one)
    for geom in list(spec.worldbody.geoms):
        spec.delete(geom)
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
    springs = [model.joint(j).name for j in own if np.any(model.jnt_stiffness[j])]
    floating = [model.body(b).name for b in np.flatnonzero(model.body_gravcomp).tolist()]
    strained = [model.tendon(t).name for t in range(model.ntendon) if np.any(model.tendon_stiffness[t])]
    lines = [
        f"left out: {what} {listed(names)}"
        for what, names in (
            ("springs of the joints", springs),
            ("springs of the tendons", strained),
            ("compensation of the weight of", floating),
        )
        if names
    ]
    if not np.allclose(model.opt.gravity, EARTH):
        lines.append(f"left out: gravity {listed(model.opt.gravity)}; it is {listed(EARTH)} m/s2")
    return lines


def _root(model: mujoco.MjModel, path: Path) -> int:
    """Return the first body of the tree with the most hinges."""
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    count = {b: int((hinge & (model.body_rootid[model.jnt_bodyid] == b)).sum()) for b in roots}
    best = max(count, key=lambda b: count[b], default=0)
    if not best or not count[best]:
        raise InputError(f"{path}: found no hinge joint, expected a robot on two legs")
    return best


def _driven(model: mujoco.MjModel, root: int, mimic: frozenset[str], assumed: list[str]) -> frozenset[str]:
    """Return the hinges that something drives; without any drive in the file, all hinges."""
    kinds = mujoco.mjtJoint
    names = {kind: [] for kind in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE, kinds.mjJNT_BALL)}
    for j in range(model.njnt):
        inside = int(model.body_rootid[model.jnt_bodyid[j]]) == root and int(model.jnt_bodyid[j]) != root
        if inside and (kind := kinds(int(model.jnt_type[j]))) in names:
            names[kind].append(model.joint(j).name)
    hinges = [name for name in names[kinds.mjJNT_HINGE] if name not in mimic]
    acts = {
        model.joint(int(model.actuator_trnid[i, 0])).name
        for i in range(model.nu)
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
    }
    for words, found in (
        ("joints that follow another one", [n for n in names[kinds.mjJNT_HINGE] if n in mimic]),
        ("sliding joints", names[kinds.mjJNT_SLIDE]),
        ("ball joints", names[kinds.mjJNT_BALL]),
        ("joints that nothing drives", [n for n in hinges if acts and n not in acts]),
    ):
        if found:
            assumed.append(f"fixed: {words}: {listed(found)}")
    if not acts:
        return frozenset(hinges)
    return frozenset(name for name in hinges if name in acts)


def _reference(model: mujoco.MjModel, assumed: list[str]) -> dict[str, float]:
    """Return the angles of a standing keyframe, or else zero, within the limits."""
    keys = [model.key(k).name for k in range(model.nkey)]
    wanted = next((name for name in STANDING if name in keys), None)
    qpos = model.qpos0 if wanted is None else model.key(wanted).qpos
    if wanted is not None:
        assumed.append(f"keyframe '{wanted}' is the start of the search for a standing posture")
    found = {}
    for j in range(model.njnt):
        joint = model.joint(j)
        if joint.type[0] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            value = float(qpos[joint.qposadr[0]])
            found[joint.name] = float(np.clip(value, *joint.range)) if joint.limited[0] else value
    return found
