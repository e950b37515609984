"""The scene: the robot on its two plates, as a rig requires it."""

from functools import lru_cache

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.measurements.cells import CORNERS, PLATES, PlateGeometry, lay_boards
from tulip_testbed.sim.compliance import Compliance, add_compliance
from tulip_testbed.sim.control import add_servos
from tulip_testbed.sim.drives import Drives, add_drives, supply_drives
from tulip_testbed.sim.plates import place_plates, plate_geometry
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, check_unchanged, load_spec, sole_corners
from tulip_testbed.sim.sensors import ANKLE
from tulip_testbed.sim.specs import compile_spec, without_meshes
from tulip_testbed.sim.wrench_sensors import add_foot_sensors

PLATE_GAP = 0.01  # m, between the boards' long edges until `place_plates` moves them
# As in the hand-written scene; docs/explanation/laboratory.md gives the reasons.
SOLE_ON_BOARD = {
    "condim": 3,
    "friction": [1.0, 1.0, 0.005, 0.0001, 0.0001],
    "solref": [0.02, 1.0],
    "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0],
    "solreffriction": [0.002, 1.0],
}
# Settings that replace those of a robot's file.
TIMESTEP = 0.001  # s
# With MuJoCo's default of 1e-8 the solver stops early, so that forces fluctuate and feet creep faster.
SOLVER_TOLERANCE = 1e-12
SOLVER = (
    *("solver", "jacobian", "iterations", "ls_iterations", "ls_tolerance"),
    *("noslip_iterations", "noslip_tolerance", "ccd_iterations", "ccd_tolerance"),
)
OPTIONS = (*SOLVER, *("impratio", "density", "viscosity", "magnetic", "wind", "disableflags", "enableflags"))
SIZES = ("memory", "njmax", "nconmax")
# Defaults of elements that the laboratory adds to a robot's scene.
LIMITS = ("limited", "range", "margin", "actfrclimited", "actfrcrange", "solref_limit", "solimp_limit")
FRICTION = ("frictionloss", "solref_friction", "solimp_friction")
DEFAULTS = {
    "geom": (
        *("condim", "priority", "friction", "solmix", "solref", "solimp"),
        *("margin", "gap", "adhesion", "surfacevel"),
    ),
    "pair": ("condim", "friction", "solref", "solreffriction", "solimp", "margin", "gap"),
    "equality": ("solref", "solimp"),
    "joint": (
        *("pos", "axis", "ref", "springref", "springdamper", "stiffness", "damping", "armature"),
        *("actgravcomp", *LIMITS, *FRICTION),
    ),
    "tendon": ("stiffness", "springlength", "damping", "armature", *LIMITS, *FRICTION),
}


def load_scene(robot: Robot) -> mujoco.MjSpec:
    """Return the nominal robot on two plates with plain motors; z = 0 is the boards' top."""
    return _nominal_scene(robot).copy()


@lru_cache(maxsize=8)
def _nominal_scene(robot: Robot) -> mujoco.MjSpec:
    if robot.scene_file is None:
        return build_scene(robot)
    check_unchanged(robot, robot.scene_file)
    spec = load_spec(robot.scene_file, robot.folder)
    return spec if robot.meshes else without_meshes(spec, str(robot.scene_file))


@lru_cache(maxsize=8)
def nominal_plates(robot: Robot) -> tuple[PlateGeometry, PlateGeometry]:
    """Read the geometry of the right and the left plate of the nominal scene."""
    scene = _nominal_scene(robot)
    return plate_geometry(scene, PLATES[0]), plate_geometry(scene, PLATES[1])


@lru_cache(maxsize=8)
def plate_masses(robot: Robot) -> tuple[float, float]:
    """Return the masses of the right and the left board with its cells [kg]."""
    scene = compile_spec(load_scene(robot), str(robot.path))
    right, left = (float(scene.body(f"{plate}_plate").mass[0]) for plate in PLATES)
    return right, left


def build_scene(robot: Robot) -> mujoco.MjSpec:
    """Build a scene of the robot and two plates, for a robot whose description names none.

    Only the sole corners of the robot make contact. All options but gravity are the laboratory's.
    """
    spec = robot.spec.copy()
    if spec.worldbody.geoms:
        names = listed(f"'{geom.name}'" for geom in spec.worldbody.geoms)
        raise InputError(f"{robot.model_file}: found geoms {names} in the world, expected the robot alone")
    make_plain(spec)
    soles = robot.sole_geoms
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = int(geom.name in soles), 0
        geom.margin = geom.gap = 0.0
    for plate in PLATES:
        frame = spec.worldbody.add_frame(name=f"{plate}_plate_place")
        frame.attach_body(_load_plate(robot), f"{plate}_", "")
    board = plate_geometry(spec, PLATES[0])
    for plate, side in zip(PLATES, (-0.5, 0.5), strict=True):
        spec.frame(f"{plate}_plate_place").pos = [0, side * (board.size[1] + PLATE_GAP), -board.top_height]
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        pos=[0, 0, -board.top_height],
        contype=0,
        conaffinity=3,
    )
    for k, sole in enumerate(soles):
        spec.add_pair(name=sole, geomname1=f"{PLATES[k // 4]}_plate_top", geomname2=sole, **SOLE_ON_BOARD)
    return spec


def _load_plate(robot: Robot) -> mujoco.MjsBody:
    """Load the body of a plate and check the names that the laboratory looks up."""
    path = robot.plate_file
    check_unchanged(robot, path)
    spec = load_spec(path, robot.folder)
    cells = [f"plate_{corner}" for corner in CORNERS]
    wanted = {"body": ["plate"], "geom": ["plate_top", *cells], "site": cells, "sensor": cells}
    for kind, names in wanted.items():
        if missing := [name for name in names if getattr(spec, kind)(name) is None]:
            raise InputError(f"{path}: no {kind} named {listed(missing)}")
    return spec.body("plate")


def laboratory_scene(rig: Rig, plate_poses: np.ndarray) -> mujoco.MjSpec:
    """Return the rig's scene: drives, servos, compliance, ankle sensors, plates, solver, and the rig's edit.

    The poses of the right and left plate are in the base frame, (2, 3) [m, m, rad].
    """
    spec = load_scene(rig.robot)
    supply_drives(spec)
    add_drives(spec, rig.drives)
    add_compliance(spec, rig.robot, rig.compliance)
    if rig.drives != Drives() or rig.compliance != Compliance():
        for key in list(spec.keys):  # keyframes do not fit the added joints
            spec.delete(key)
    add_servos(spec, rig.controller)
    if rig.sensors.wrench is not None and rig.sensors.wrench.place == ANKLE:
        add_foot_sensors(spec, rig.robot.feet, rig.sensors.wrench.mounting)
    place_plates(spec, plate_poses)
    # How MuJoCo solves for the constraint forces, in any scene of the laboratory.
    _copy(SOLVER, mujoco.MjSpec().option, spec.option)
    spec.option.tolerance = SOLVER_TOLERANCE
    if rig.edit is not None:
        rig.edit(spec)
    return spec


def boards_under(rig: Rig, foot_poses: np.ndarray) -> np.ndarray:
    """Return intended poses of the two boards for poses of the feet in the base frame, both (k, 2, 3)."""
    size = nominal_plates(rig.robot)[0].size
    model = rig.robot.model
    corners = np.array([sole_corners(model, foot)[:, :2] for foot in rig.robot.feet])
    c, s = np.cos(foot_poses[..., 2]), np.sin(foot_poses[..., 2])
    turn = np.moveaxis(np.array([[c, s], [-s, c]]), (0, 1), (-2, -1))
    soles = corners @ turn + foot_poses[..., None, :2]
    return np.array([lay_boards(pair, size, rig.protocol.plate_gap) for pair in soles])


def make_plain(spec: mujoco.MjSpec) -> None:
    """Make a robot's file a scene of the laboratory: its options, sizes, defaults and contacts.

    Gravity stays the robot's; so do all values that its elements took from its defaults.
    """
    plain = mujoco.MjSpec()
    _copy(OPTIONS, plain.option, spec.option)
    _copy(SIZES, plain, spec)
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    for kind, names in DEFAULTS.items():
        _copy(names, getattr(plain.default, kind), getattr(spec.default, kind))
    for contact in [*spec.pairs, *spec.excludes]:
        spec.delete(contact)


def _copy(names: tuple[str, ...], source: object, target: object) -> None:
    for name in names:
        setattr(target, name, getattr(source, name))
