"""A robot without its file's peculiarities: MuJoCo has fixed to every link all that moves with it."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from tulip_testbed.sim.robot import bodies_to_root, quaternion, rotation_matrices
from tulip_testbed.sim.specs import compile_spec

Array = NDArray[np.float64]
LEAST_MASS = 1e-6  # kg, of a link that moves: MuJoCo refuses less
LEAST_INERTIA = 1e-9  # kg m2
FLAT = 2e-5  # m: thinner meshes have no hull when their vertices are rounded
ROUND = 24  # points on the rim of a cylinder or along an ellipsoid
KINDS = mujoco.mjtGeom


@dataclass(frozen=True)
class SourceFile:
    """A published model as it was read.

    Attributes:
        model: compiled; all geometry, without what stands in the world.
        root: its first body.
        driven: hinges that something drives, and all hinges of a model that drives none.
        torque: limits of the drives by joint [Nm].
        reference: joint angles at which what is not driven is fixed, and where a standing posture is
            tried first, by joint [rad].
        assumed, problems: sentences on what was read.
    """

    model: mujoco.MjModel
    root: int
    driven: frozenset[str]
    torque: dict[str, float]
    reference: dict[str, float]
    assumed: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()

    def at_zero(self, turning: Collection[str]) -> mujoco.MjData:
        """Return the kinematics with some joints at zero and the others at their reference."""
        data = mujoco.MjData(self.model)
        for joint in map(self.model.joint, range(self.model.njnt)):
            if joint.type[0] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                turns = joint.name in turning
                data.qpos[joint.qposadr[0]] = 0.0 if turns else self.reference.get(joint.name, 0.0)
        mujoco.mj_kinematics(self.model, data)
        return data


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A robot whose links all move: bodies from 1, the root.

    Attributes:
        model: the robot alone; shapes that collide have a `contype`.
        data: its kinematics at zero angles.
    """

    model: mujoco.MjModel
    data: mujoco.MjData

    @property
    def mass(self) -> float:
        """Return the mass of the whole robot [kg]."""
        return float(self.model.body_subtreemass[1])

    @property
    def links(self) -> range:
        return range(1, self.model.nbody)

    def name(self, link: int) -> str:
        return self.model.body(link).name

    def hinges(self, links: Collection[int] | None = None) -> list[str]:
        """Return the names of the hinges of some links, or of all, in order."""
        joints = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
        wanted = self.links if links is None else links
        return [self.model.joint(int(j)).name for j in joints if self.model.jnt_bodyid[j] in wanted]

    def path(self, link: int) -> set[int]:
        """Return the links from the root to a link, both included."""
        return set(bodies_to_root(self.model, link))

    def pose(self, link: int) -> tuple[Array, Array]:
        """Return place, (3,) [m], and axes, (3, 3), of a link in the world."""
        return self.data.xpos[link].copy(), self.data.xmat[link].reshape(3, 3).copy()

    def solid(self, link: int) -> list[int]:
        """Return the shapes of a link that collide, or all if none does."""
        shapes = np.flatnonzero(self.model.geom_bodyid == link)
        solid = shapes[self.model.geom_contype[shapes] > 0]
        return (solid if len(solid) else shapes).tolist()

    def points(self, geom: int) -> tuple[Array, float]:
        """Return points, (k, 3) [m] in the world, and a radius [m]: the shape is the hull of balls there."""
        kind, (x, y, z) = self.model.geom_type[geom], self.model.geom_size[geom]
        radius, local = 0.0, np.zeros((1, 3))
        if kind == KINDS.mjGEOM_MESH:
            local = mesh_vertices(self.model, geom)
        elif kind == KINDS.mjGEOM_SPHERE:
            radius = x
        elif kind == KINDS.mjGEOM_CAPSULE:
            radius, local = x, np.array([[0, 0, y], [0, 0, -y]])
        elif kind == KINDS.mjGEOM_BOX:
            local = np.array(list(product((x, -x), (y, -y), (z, -z))))
        else:
            angle = 2 * np.pi * np.arange(ROUND) / ROUND
            rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(ROUND)])
            if kind == KINDS.mjGEOM_CYLINDER:
                local = np.concatenate([rim * [x, x, 0] + [0, 0, side * y] for side in (1, -1)])
            else:
                heights = np.sin(np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2 + 1))
                rings = [(rim * np.sqrt(max(1 - h * h, 0.0)) + [0, 0, h]) * [x, y, z] for h in heights]
                local = np.concatenate(rings)
        turn = self.data.geom_xmat[geom].reshape(3, 3)
        return self.data.geom_xpos[geom] + local @ turn.T, float(radius)

    def lowest(self, link: int, up: Array) -> float:
        """Return the height of its lowest point along a direction [m], infinite without shapes."""
        balls = map(self.points, self.solid(link))
        return min((float((points @ up).min()) - radius for points, radius in balls), default=np.inf)


def skeleton_of(source: SourceFile, fixed: Collection[str] = ()) -> Skeleton:
    """Return the links of a model; what nothing drives, and what is to be `fixed`, has no joint."""
    moving = source.driven - frozenset(fixed)
    spec = tree_spec(source.model, source.at_zero(source.driven), source.root, moving)
    spec.compiler.fusestatic = True
    model = compile_spec(spec, "skeleton")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return Skeleton(model, data)


def tree_spec(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    root: int,
    moving: Collection[str],
    frames: Mapping[int, tuple[Array, Array]] | None = None,
    digits: int = 16,
) -> mujoco.MjSpec:
    """Write a tree of bodies again: inertias, hinges about their place in `data`, and convex shapes.

    Args:
        data: kinematics. root: the first body. moving: hinges to keep, by name.
        frames: place and axes in the world of bodies that shall not have their own, by number.
        digits: of the vertices of meshes.
    """
    spec, heavy = mujoco.MjSpec(), np.where(model.body_mass > LEAST_MASS, model.body_mass, 0.0)
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    hinges: dict[int, list[int]] = {}
    for j in range(model.njnt):
        if model.joint(j).name in moving:
            hinges.setdefault(int(model.jnt_bodyid[j]), []).append(j)
    tree = [body for body in range(root, model.nbody) if model.body_rootid[body] == root]
    carried = heavy.copy()  # by a link and what is fixed to it
    for body in reversed(tree[1:]):
        if body not in hinges:
            carried[model.body_parentid[body]] += carried[body]
    places = {body: (data.xpos[body], data.xmat[body].reshape(3, 3)) for body in tree} | dict(frames or {})
    bodies, meshes, hulls = {0: spec.worldbody}, dict[int, str](), dict[int, Array]()
    for body in tree:
        above, (place, turn) = int(model.body_parentid[body]), places[body]
        base, axes = places.get(above, (np.zeros(3), np.eye(3)))
        mass, moments = heavy[body], model.body_inertia[body] if heavy[body] else np.zeros(3)
        moves = body == root or body in hinges
        if moves and not carried[body]:
            mass, moments = LEAST_MASS, np.full(3, LEAST_INERTIA)
        bodies[body] = bodies[above].add_body(
            name=model.body(body).name,
            pos=axes.T @ (place - base),
            quat=quaternion(axes.T @ turn),
            mass=mass,
            ipos=turn.T @ (data.xipos[body] - place),
            iquat=quaternion(turn.T @ data.ximat[body].reshape(3, 3)),
            inertia=moments,
            explicitinertial=True,
        )
        if body == root:
            bodies[body].add_freejoint(name=f"{model.body(body).name}_free")
        for j in hinges.get(body, ()):
            dof = model.jnt_dofadr[j]
            bodies[body].add_joint(
                name=model.joint(j).name,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                pos=turn.T @ (data.xanchor[j] - place),
                axis=turn.T @ data.xaxis[j],
                limited=bool(model.jnt_limited[j]),
                range=model.jnt_range[j],
                armature=model.dof_armature[dof],
                damping=[model.dof_damping[dof], 0, 0],
                frictionloss=model.dof_frictionloss[dof],
            )
        for number, geom in enumerate(np.flatnonzero(model.geom_bodyid == body).tolist()):
            is_mesh, mesh = model.geom_type[geom] == KINDS.mjGEOM_MESH, int(model.geom_dataid[geom])
            if is_mesh and mesh not in hulls:
                hulls[mesh] = np.round(hull(mesh_vertices(model, geom)), digits)
            if is_mesh and not len(hulls[mesh]):
                continue
            own = data.xmat[body].reshape(3, 3)
            collides = int(bool(model.geom_contype[geom] or model.geom_conaffinity[geom]))
            shape = bodies[body].add_geom(
                type=model.geom_type[geom],
                size=model.geom_size[geom],
                pos=turn.T @ (data.xpos[body] + own @ model.geom_pos[geom] - place),
                quat=quaternion(turn.T @ own @ rotation_matrices(model.geom_quat[geom][None])[0]),
                rgba=model.geom_rgba[geom],
                group=3 if collides else 2,
                contype=collides,
                conaffinity=collides,
                mass=0.0,
            )
            if is_mesh:
                if mesh not in meshes:
                    meshes[mesh] = f"{model.body(body).name}_shape{number}"
                    spec.add_mesh(name=meshes[mesh], uservert=hulls[mesh].ravel())
                shape.meshname, shape.size = meshes[mesh], [0, 0, 0]
    return spec


def mesh_vertices(model: mujoco.MjModel, geom: int) -> Array:
    """Return the vertices of a geom's mesh in its frame, (k, 3) [m]."""
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_vertadr[mesh])
    return model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)


def hull(vertices: Array) -> Array:
    """Return the vertices of a convex hull, (k, 3) [m]; none of a mesh that is flat."""
    from scipy.spatial import ConvexHull

    return vertices[:0] if is_flat(vertices) else vertices[ConvexHull(vertices).vertices]


def is_flat(vertices: Array) -> bool:
    """Return whether vertices, (k, 3) [m], lie in a plane."""
    middle = vertices - vertices.mean(axis=0)
    across = np.linalg.eigh(middle.T @ middle)[1][:, 0]
    return len(vertices) < 4 or bool(np.ptp(middle @ across) < FLAT)
