"""Read a robot as people publish it: an MJCF or a URDF."""

from pathlib import Path

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import present, read_bytes
from tulip_testbed.experiments.robot_import.skeleton import SourceFile, is_flat, mesh_vertices
from tulip_testbed.experiments.robot_import.urdf import Parsed, read_urdf
from tulip_testbed.sim.control import joint_torques
from tulip_testbed.sim.mjcf_files import mjcf_files
from tulip_testbed.sim.model_check import MOST_MASS
from tulip_testbed.sim.sandbox import call_safely
from tulip_testbed.sim.specs import BROKEN, compile_spec, read_spec

STANDING = ("stand", "home", "standing", "stand_bent_knees", "knees_bent", "default")  # names of keyframes
EARTH = (0.0, 0.0, -9.81)  # m/s2
LOOPS = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
MESH, HINGE = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtJoint.mjJNT_HINGE
MOST_LINKS = 1000
MOST_SHAPE = 5.0  # m
MOST_ANGLE = 4 * np.pi, 360.0  # rad: limits between these were degrees; larger ones are none


def read_published(path: Path) -> SourceFile:
    """Read a published robot, in a separate process, which a file may crash or keep busy for ever.

    Raises:
        InputError: no MJCF or URDF, closed loops, or numbers that no robot has.
    """
    if not present(path):
        raise InputError(f"{path}: no such file, expected an MJCF or a URDF")
    return call_safely(read_here, path)


def read_here(path: Path) -> SourceFile:
    """Read a published robot in this process, see `read_published`."""
    head = read_bytes(path)[:4096]
    if b"<robot" in head or path.suffix == ".urdf":
        spec, followers, assumed, missing = read_urdf(path)
    elif b"<mujoco" in head or path.suffix == ".xml":
        spec, followers, assumed, missing = _mjcf(path)
    else:
        kind = "an SDF" if b"<sdf" in head else f"'{path.suffix}'"
        raise InputError(f"{path}: found {kind}, expected an MJCF or a URDF")
    _name_and_check(spec, path)
    model, unread = _compiled(spec, path)
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    of_hinges = model.body_rootid[model.jnt_bodyid[model.jnt_type == HINGE]]
    root = max(roots, key=lambda b: int((of_hinges == b).sum()), default=0)
    if not root or root not in of_hinges:
        raise InputError(f"{path}: found no hinge joint, expected a robot on two legs")
    _check_tree(model, root, path)
    torque = dict(joint_torques(spec))
    for j in range(model.njnt):  # a URDF's effort
        if model.jnt_actfrclimited[j]:
            name, limit = model.joint(j).name, float(model.jnt_actfrcrange[j, 1])
            if limit > 0:
                torque[name] = min(torque.get(name, np.inf), limit)
    driven = _driven(model, root, followers, assumed)
    keys = [model.key(k).name for k in range(model.nkey)]
    wanted = next((name for name in STANDING if name in keys), None)
    qpos = model.qpos0 if wanted is None else model.key(wanted).qpos
    if wanted is not None:
        assumed.append(f"keyframe '{wanted}' is the start of the search for a standing posture")
    reference = {}
    for joint in map(model.joint, range(model.njnt)):
        if joint.type[0] in (HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            angle = float(qpos[joint.qposadr[0]])
            reference[joint.name] = float(np.clip(angle, *joint.range)) if joint.limited[0] else angle
    assumed += _left_out(model, root)
    bad = sorted({*missing, *unread})
    problems = [f"{len(bad)} meshes are missing or cannot be read: {listed(bad, 3)}"] if bad else []
    return SourceFile(
        model=model,
        root=root,
        driven=driven,
        torque=torque,
        reference=reference,
        assumed=tuple(assumed),
        problems=tuple(problems),
    )


def _mjcf(path: Path) -> Parsed:
    """Parse an MJCF, without what no laboratory needs."""
    folder = path.resolve().parents[min(2, len(path.resolve().parents) - 1)]
    mjcf_files(path.resolve(), folder)
    spec = read_spec(path)
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
    if spec.plugins or spec.flexes:
        raise InputError(f"{path}: found plugins or flexible bodies, expected rigid bodies alone")
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    of_world = [*spec.worldbody.geoms, *spec.textures, *spec.skins, *spec.hfields]
    for element in [*spec.equalities, *spec.pairs, *spec.sensors, *of_world]:
        spec.delete(element)
    return spec, frozenset(coupled), [], []


def _name_and_check(spec: mujoco.MjSpec, path: Path) -> None:
    """Name what has no name, and refuse what MuJoCo would change without a word."""
    for kind, elements in (("body", spec.bodies[1:]), ("joint", spec.joints)):
        for k, element in enumerate(elements):
            element.name = element.name or f"{kind}_{k}"
    for k, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"{geom.parent.name}, geom {k}"
    for body in spec.bodies:
        if body.mass < 0:
            raise InputError(f"{path}: link '{body.name}': found mass {body.mass:g} kg, expected 0 or more")
    for joint in spec.joints:
        low, high = joint.range
        if low > high:
            raise InputError(
                f"{path}: joint '{joint.name}': found range [{low:g}, {high:g}], expected low < high"
            )


def _compiled(spec: mujoco.MjSpec, path: Path) -> tuple[mujoco.MjModel, list[str]]:
    """Compile a spec, where that fails without the meshes that cannot be read; return the model and these."""
    try:
        return compile_spec(spec, str(path)), []
    except InputError:
        unread = [mesh for mesh in spec.meshes if mesh.file and not _is_mesh(spec, mesh)]
        files = {mesh.name: mesh.file for mesh in unread}
        if not files:
            raise
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    for geom in [geom for geom in spec.geoms if geom.meshname in files]:
        inferred = from_geoms or not geom.parent.explicitinertial
        if inferred and geom.density and geom.mass != 0:
            raise InputError(
                f"{path}: mesh '{files[geom.meshname]}' is missing or cannot be read: the mass of the link "
                f"'{geom.parent.name}' depends on it"
            )
        spec.delete(geom)
    for mesh in unread:
        spec.delete(mesh)
    return compile_spec(spec, str(path)), [*files.values()]


def _is_mesh(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> bool:
    """Return whether a mesh can be read, and has a convex hull if it needs one."""
    alone = mujoco.MjSpec()
    alone.modelfiledir, alone.meshdir, alone.assets = spec.modelfiledir, spec.meshdir, spec.assets
    alone.add_mesh(name="mesh", file=mesh.file, scale=mesh.scale, inertia=mesh.inertia)
    needs_hull = any(geom.contype or geom.conaffinity for geom in spec.geoms if geom.meshname == mesh.name)
    alone.worldbody.add_geom(type=MESH, meshname="mesh", contype=int(needs_hull), conaffinity=0)
    try:
        alone.compile()
    except BROKEN:
        return False
    return True


def _check_tree(model: mujoco.MjModel, root: int, path: Path) -> None:
    if model.nbody > MOST_LINKS:
        raise InputError(f"{path}: found {model.nbody - 1} links, expected at most {MOST_LINKS}")
    own = model.body_rootid == root
    for body in np.flatnonzero(own & (model.body_mass > MOST_MASS))[:1]:
        found = f"'{model.body(body).name}': found mass {model.body_mass[body]:g} kg"
        raise InputError(f"{path}: link {found}, expected at most {MOST_MASS:g} kg")
    apart = np.linalg.norm(model.body_ipos, axis=1)
    for body in np.flatnonzero(own & (apart > MOST_SHAPE))[:1]:
        raise InputError(
            f"{path}: link '{model.body(body).name}': found its centre of mass {apart[body]:.3g} m away, "
            f"expected at most {MOST_SHAPE:g} m; millimetres?"
        )
    for geom in np.flatnonzero(own[model.geom_bodyid] & (2 * model.geom_rbound > MOST_SHAPE))[:1]:
        name = model.body(model.geom_bodyid[geom]).name
        raise InputError(
            f"{path}: link '{name}': found a shape of {2 * model.geom_rbound[geom]:.3g} m, expected at most "
            f"{MOST_SHAPE:g} m; a mesh in millimetres needs the scale 0.001"
        )
    turns = own[model.jnt_bodyid] & (model.jnt_type == HINGE) & model.jnt_limited.astype(bool)
    angle = np.abs(model.jnt_range).max(axis=1)
    for joint in np.flatnonzero(turns & (angle > MOST_ANGLE[0]) & (angle <= MOST_ANGLE[1]))[:1]:
        raise InputError(
            f"{path}: joint '{model.joint(joint).name}': found limits {listed(model.jnt_range[joint])} rad, "
            f"expected at most {MOST_ANGLE[0]:.1f} rad; are they in degrees?"
        )


def _left_out(model: mujoco.MjModel, root: int) -> list[str]:
    """Say which forces of the file the prepared robot does not have."""
    own = [j for j in range(model.njnt) if int(model.body_rootid[model.jnt_bodyid[j]]) == root]
    strained = [t for t in range(model.ntendon) if np.any(model.tendon_stiffness[t])]
    others = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and b != root]
    shown = {int(model.geom_dataid[g]): g for g in np.flatnonzero(model.geom_type == MESH).tolist()}
    flat = [mesh for mesh, geom in shown.items() if is_flat(mesh_vertices(model, geom))]
    name = [model.body(b).name for b in range(model.nbody)]
    forces = {
        "springs of the joints": [model.joint(j).name for j in own if np.any(model.jnt_stiffness[j])],
        "springs of the tendons": [model.tendon(t).name for t in strained],
        "compensation of the weight of": [name[b] for b in np.flatnonzero(model.body_gravcomp)],
        "flat meshes": [model.mesh(mesh).name for mesh in flat],  # of which no shape is made
        "<exclude>, so that plans keep a distance between": [
            f"{name[pair >> 16]} and {name[pair & 0xFFFF]}" for pair in model.exclude_signature
        ],
        "what no joint connects with the robot:": [
            f"{name[b]} ({round(model.body_subtreemass[b], 3):g} kg)" for b in others
        ],
    }
    lines = [f"left out: {force} {listed(names)}" for force, names in forces.items() if names]
    if not np.allclose(model.opt.gravity, EARTH):
        lines.append(f"left out: gravity {listed(model.opt.gravity)}; it is {listed(EARTH)} m/s2")
    return lines


def _driven(
    model: mujoco.MjModel, root: int, followers: frozenset[str], assumed: list[str]
) -> frozenset[str]:
    """Return the hinges that something drives; without any drive in the file, all hinges."""
    inside = (model.body_rootid[model.jnt_bodyid] == root) & (model.jnt_bodyid != root)

    def named(kind: mujoco.mjtJoint) -> list[str]:
        return [model.joint(int(j)).name for j in np.flatnonzero(inside & (model.jnt_type == kind))]

    by_joint = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
    driven = {model.joint(int(model.actuator_trnid[i, 0])).name for i in by_joint}
    every = named(HINGE)
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
