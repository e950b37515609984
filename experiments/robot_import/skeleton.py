"""A robot without its file's peculiarities: links, hinges and shapes, all in world coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST_MASS = 1e-6  # kg, of a link that moves: MuJoCo refuses less
LEAST_INERTIA = 1e-9  # kg m2
ROUND = 24  # points on the rim of a cylinder or along an ellipsoid


@dataclass(frozen=True)
class Hinge:
    """A hinge of the robot.

    Attributes:
        name: of the joint.
        anchor, axis: a point on the axis and its direction, in the world at zero angles, (3,) [m], [-].
        range: limits, infinite where there are none, (2,) [rad].
        torque: limit of the drive [Nm], None if the file gives none.
        armature, damping, friction: [kg m2, Nm s, Nm].
    """

    name: str
    anchor: Array
    axis: Array
    range: Array
    torque: float | None
    armature: float
    damping: float
    friction: float


@dataclass(frozen=True)
class Shape:
    """A geometric shape of a link.

    Attributes:
        kind: of MuJoCo. size: as MuJoCo has it, (3,) [m].
        place, turn: of its frame in the world at zero angles, (3,) [m] and (3, 3).
        vertices: of a mesh, in the shape's frame, (k, 3) [m].
        collides: whether the file lets it touch other things.
        color: (4,).
    """

    kind: mujoco.mjtGeom
    size: Array
    place: Array
    turn: Array
    vertices: Array | None
    collides: bool
    color: Array

    def points(self) -> tuple[Array, float]:
        """Return points, (k, 3) [m] in the world, and a radius [m]: the shape is the hull of balls there."""
        x, y, z = self.size
        kinds = mujoco.mjtGeom
        radius, local = 0.0, np.zeros((1, 3))
        if self.vertices is not None:
            local = self.vertices
        elif self.kind == kinds.mjGEOM_SPHERE:
            radius = x
        elif self.kind == kinds.mjGEOM_CAPSULE:
            radius, local = x, np.array([[0, 0, y], [0, 0, -y]])
        elif self.kind == kinds.mjGEOM_BOX:
            local = np.array(list(product((x, -x), (y, -y), (z, -z))))
        else:
            angle = 2 * np.pi * np.arange(ROUND) / ROUND
            rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(ROUND)])
            if self.kind == kinds.mjGEOM_CYLINDER:
                local = np.concatenate([rim * [x, x, 0] + [0, 0, side * y] for side in (1, -1)])
            else:
                heights = np.sin(np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2 + 1))
                local = np.concatenate(
                    [(rim * np.sqrt(max(1 - h * h, 0.0)) + [0, 0, h]) * self.size for h in heights]
                )
        return self.place + local @ self.turn.T, float(radius)


@dataclass(frozen=True)
class Link:
    """A link with all that is fixed to it.

    Attributes:
        name: of the body.
        parent: number of the link above, -1 for the root.
        place, turn: of its frame in the world at zero angles, (3,) [m] and (3, 3).
        mass: [kg]. center: of mass, in the world, (3,) [m].
        inertia: about the centre of mass along the world's axes, (3, 3) [kg m2].
        hinges: that move it against its parent, in order.
        shapes: its geometry.
    """

    name: str
    parent: int
    place: Array
    turn: Array
    mass: float
    center: Array
    inertia: Array
    hinges: tuple[Hinge, ...] = ()
    shapes: tuple[Shape, ...] = ()

    def solid(self) -> tuple[Shape, ...]:
        """Return the shapes that collide, or all if none does."""
        return tuple(shape for shape in self.shapes if shape.collides) or self.shapes

    def lowest(self, up: Array) -> float:
        """Return the height of its lowest point along a direction [m], infinite without shapes."""
        return min((float((p @ up).min()) - r for p, r in (s.points() for s in self.solid())), default=np.inf)


@dataclass(frozen=True)
class Skeleton:
    """All links, the root first and parents before their children."""

    links: tuple[Link, ...]

    @property
    def mass(self) -> float:
        """Return the mass of the whole robot [kg]."""
        return sum(link.mass for link in self.links)

    @property
    def hinges(self) -> tuple[Hinge, ...]:
        """Return all hinges in order."""
        return tuple(hinge for link in self.links for hinge in link.hinges)

    def number(self, name: str) -> int:
        """Return the number of a link."""
        return next(k for k, link in enumerate(self.links) if link.name == name)

    def path(self, link: int) -> tuple[int, ...]:
        """Return the links from the root to a link, both included."""
        above = self.links[link].parent
        return (*(self.path(above) if above >= 0 else ()), link)

    def beyond(self, link: int) -> float:
        """Return the mass that a link carries, its own included [kg]."""
        return sum(self.links[k].mass for k in range(len(self.links)) if link in self.path(k))


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
        collides: of the geoms, (ngeom,) bool.
        assumed, problems: sentences on what was read.
    """

    model: mujoco.MjModel
    root: int
    driven: frozenset[str]
    torque: dict[str, float]
    reference: dict[str, float]
    collides: np.ndarray
    assumed: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    hulls: dict[int, Array] = field(default_factory=dict)


def skeleton_of(source: SourceFile) -> Skeleton:
    """Return the links of a model; what nothing drives is fixed to the link above it."""
    model, root = source.model, source.root
    data = mujoco.MjData(model)
    for k in range(model.njnt):
        joint, address = model.joint(k), int(model.jnt_qposadr[k])
        if joint.type[0] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            fixed = joint.name not in source.driven
            data.qpos[address] = source.reference.get(joint.name, 0.0) if fixed else 0.0
    mujoco.mj_kinematics(model, data)
    numbers: dict[int, int] = {}
    links: list[Link] = []
    for body in range(1, model.nbody):
        if int(model.body_rootid[body]) != root:
            continue
        hinges = _hinges(source, data, body)
        if hinges or body == root:
            numbers[body] = len(links)
            parent = -1 if body == root else numbers[int(model.body_parentid[body])]
            links.append(_link(source, data, body, parent, hinges))
        else:
            numbers[body] = numbers[int(model.body_parentid[body])]
            rest = _link(source, data, body, -1, ())
            links[numbers[body]] = joined(links[numbers[body]], rest)
    return Skeleton(tuple(links))


def joined(link: Link, other: Link) -> Link:
    """Return a link with all of another one fixed to it."""
    mass = link.mass + other.mass
    if mass == 0:
        return replace(link, shapes=link.shapes + other.shapes)
    center = (link.mass * link.center + other.mass * other.center) / mass
    inertia = np.zeros((3, 3))
    for part in (link, other):
        arm = part.center - center
        inertia += part.inertia + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return replace(link, mass=mass, center=center, inertia=inertia, shapes=link.shapes + other.shapes)


def fixed(skeleton: Skeleton, names: frozenset[str]) -> Skeleton:
    """Return a skeleton in which some hinges do not move any more, at their zero."""
    links: list[Link] = []
    numbers: list[int] = []
    for link in skeleton.links:
        hinges = tuple(hinge for hinge in link.hinges if hinge.name not in names)
        parent = -1 if link.parent < 0 else numbers[link.parent]
        if hinges or parent < 0:
            numbers.append(len(links))
            links.append(replace(link, parent=parent, hinges=hinges))
        else:
            numbers.append(parent)
            links[parent] = joined(links[parent], link)
    return Skeleton(tuple(links))


def _link(source: SourceFile, data: mujoco.MjData, body: int, parent: int, hinges: tuple[Hinge, ...]) -> Link:
    model = source.model
    turn = data.ximat[body].reshape(3, 3)
    first = int(model.body_geomadr[body])
    mass = float(model.body_mass[body])
    massive = mass > LEAST_MASS
    return Link(
        name=model.body(body).name or f"link_{body}",
        parent=parent,
        place=data.xpos[body].copy(),
        turn=data.xmat[body].reshape(3, 3).copy(),
        mass=mass if massive else 0.0,
        center=data.xipos[body].copy(),
        inertia=(turn * model.body_inertia[body]) @ turn.T if massive else np.zeros((3, 3)),
        hinges=hinges,
        shapes=tuple(_shape(source, data, g) for g in range(first, first + int(model.body_geomnum[body]))),
    )


def _hinges(source: SourceFile, data: mujoco.MjData, body: int) -> tuple[Hinge, ...]:
    model, first = source.model, int(source.model.body_jntadr[body])
    joints = [model.joint(k) for k in range(first, first + int(model.body_jntnum[body]))]
    return tuple(
        Hinge(
            name=joint.name,
            anchor=data.xanchor[joint.id].copy(),
            axis=data.xaxis[joint.id].copy(),
            range=joint.range.copy() if joint.limited[0] else np.array([-np.inf, np.inf]),
            torque=source.torque.get(joint.name),
            armature=float(model.dof_armature[joint.dofadr[0]]),
            damping=float(np.ravel(model.dof_damping[joint.dofadr[0]])[0]),
            friction=float(model.dof_frictionloss[joint.dofadr[0]]),
        )
        for joint in joints
        if joint.name in source.driven
    )


def _shape(source: SourceFile, data: mujoco.MjData, geom: int) -> Shape:
    model, vertices = source.model, None
    kind, body = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_bodyid[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        if mesh not in source.hulls:
            first = int(model.mesh_vertadr[mesh])
            every = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)
            source.hulls[mesh] = hull(every)
        vertices = source.hulls[mesh]
    turn = data.xmat[body].reshape(3, 3)
    return Shape(
        kind=kind,
        size=model.geom_size[geom].copy(),
        place=data.xpos[body] + turn @ model.geom_pos[geom],
        turn=turn @ rotation(model.geom_quat[geom]),
        vertices=vertices,
        collides=bool(source.collides[geom]),
        color=model.geom_rgba[geom].astype(float),
    )


def hull(vertices: Array) -> Array:
    """Return the vertices of a convex hull, (k, 3) [m]; a flat mesh keeps its own."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return vertices[ConvexHull(vertices).vertices]
    except QhullError:
        return vertices


def rotation(quaternion: np.ndarray) -> Array:
    """Return the rotation matrix of a unit quaternion, (3, 3)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, float))
    return matrix.reshape(3, 3)


def quaternion(turn: np.ndarray) -> Array:
    """Return the unit quaternion of a rotation matrix, (4,)."""
    unit = np.zeros(4)
    mujoco.mju_mat2Quat(unit, np.ascontiguousarray(turn).ravel())
    return unit
