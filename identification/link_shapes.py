"""The shapes of a robot's links, by which links collide with each other and with the ground."""

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from tulip_testbed.identification.kinematics import Tree, tree_of
from tulip_testbed.sim.robot import Robot, check_unchanged, rotation_matrices, sole_point
from tulip_testbed.sim.specs import compile_spec, without_meshes

GROUND = "ground"
SLAB = (10.0, 10.0, 0.5)  # half edges of the ground [m]
MESH, BOX = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_BOX
FLAT = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
TOLERANCE, ITERATIONS = 1e-10, 200  # of MuJoCo's distance between convex shapes [m]


@dataclass(frozen=True)
class LinkShapes:
    """Shapes of the links, and of the ground as the last one, in the frames of the links; g shapes.

    The shapes of a link are its geoms that can collide, or all of them if none can but the corners of a sole;
    a mesh counts as its convex hull. The ground belongs to the stance foot, which does not move on it.

    Attributes:
        model: the robot and the ground, with the hulls of meshes.
        data: MuJoCo's data, in which the poses of shapes are set.
        tree: kinematic tree of the robot.
        base: frame of the stance foot.
        origin: its origin in the base frame, (3,) [m].
        geoms: number of each shape in the model, (g,).
        frame: frame of each, (g,).
        place, turn: pose of each in its frame, (g, 3) [m] and (g, 3, 3).
        ends, radius: capsule around each in its frame, (g, 2, 3) and (g,) [m].
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    tree: Tree
    base: int
    origin: np.ndarray
    geoms: np.ndarray
    frame: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    ends: np.ndarray
    radius: np.ndarray


@lru_cache(maxsize=2)
def link_shapes(robot: Robot) -> LinkShapes:
    spec = _whole_spec(robot)
    rigid = {robot.model.body(i).name: int(robot.model.body_weldid[i]) for i in range(robot.model.nbody)}
    touching = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    able = [g for g in _solid_geoms(spec, robot) if g.contype or g.conaffinity or g.name in touching]
    links = {rigid[geom.parent.name] for geom in able}
    chosen = able + [g for g in _solid_geoms(spec, robot) if rigid[g.parent.name] not in links]
    links = {rigid[geom.parent.name] for geom in chosen}
    chosen += [g for g in spec.geoms if g.name in robot.sole_geoms and rigid[g.parent.name] not in links]
    for geom in chosen:
        if geom.type == MESH:
            geom.contype = 1  # or MuJoCo makes no hull
    spec = without_meshes(spec, str(robot.model_file))
    ground = spec.worldbody.add_geom(type=BOX, size=SLAB)
    model = compile_spec(spec, str(robot.model_file))
    model.opt.ccd_tolerance, model.opt.ccd_iterations = TOLERANCE, ITERATIONS
    return _shapes(robot, model, np.array([*sorted(geom.id for geom in chosen), ground.id]))


def _whole_spec(robot: Robot) -> mujoco.MjSpec:
    if robot.meshes:
        return robot.spec.copy()
    check_unchanged(robot, robot.model_file)
    whole = mujoco.MjSpec.from_file(str(robot.model_file))
    return whole if whole.meshes else robot.spec.copy()


def _solid_geoms(spec: mujoco.MjSpec, robot: Robot) -> list[mujoco.MjsGeom]:
    """List all geoms but the corners of the soles and infinite ones."""
    return [geom for geom in spec.geoms if geom.name not in robot.sole_geoms and geom.type not in FLAT]


def _shapes(robot: Robot, model: mujoco.MjModel, geoms: np.ndarray) -> LinkShapes:
    tree = tree_of(robot.model)
    base, point = tree.frame(robot.stance_foot), sole_point(robot.model, robot.stance_foot)
    bodies = model.geom_bodyid[geoms]
    frame = np.array([tree.frame(model.body(b).name) if b else base for b in bodies])
    place, turn = model.geom_pos[geoms].copy(), rotation_matrices(model.geom_quat[geoms])
    place[-1] = point - [0.0, 0.0, SLAB[2]]
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    types = model.geom_type[geoms]
    longest = np.where(types == mujoco.mjtGeom.mjGEOM_CYLINDER, 2, half.argmax(axis=1))
    along = np.eye(3)[longest]
    across = half * (1 - along)
    cornered = np.isin(types, (MESH, BOX))
    radius = np.where(cornered, np.linalg.norm(across, axis=1), across.max(axis=1))
    hemispheres = np.isin(types, (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE))
    length = (half * along).sum(axis=1) - np.where(hemispheres, radius, 0.0)
    arm = length[:, None] * along
    ends = (turn[:, None] @ np.stack([middle - arm, middle + arm], axis=1)[..., None])[..., 0]
    return LinkShapes(
        model=model,
        data=mujoco.MjData(model),
        tree=tree,
        base=base,
        origin=-point,
        geoms=geoms,
        frame=frame,
        place=place,
        turn=turn,
        ends=ends + place[:, None],
        radius=radius,
    )
