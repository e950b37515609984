"""Prepare a published robot: find what the laboratory needs, and write it as MJCF and a description.

Drives, planning ranges and margins that the published file lacks are scaled to the robot.
"""

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.base.column import printable
from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.files import new_folder, write_bytes, write_text
from tulip_testbed.experiments.robot_import.feet import Stance, stance_of
from tulip_testbed.experiments.robot_import.published import read_published
from tulip_testbed.experiments.robot_import.skeleton import Skeleton, SourceFile, skeleton_of, tree_spec
from tulip_testbed.experiments.robot_import.standing_posture import Standing, standing
from tulip_testbed.identification.link_clearances import clearances_at, unjoined_pairs
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.drives import LEAST_ARMATURE, SOLIMP_FRICTION, SOLREF_FRICTION
from tulip_testbed.sim.robot import DESCRIPTION, Robot, load_robot
from tulip_testbed.sim.specs import compile_spec, xml_of

LIGHT = 0.005  # of the robot's mass: a joint that moves less is fixed
NEAR = 0.1  # m: links farther apart are not looked at
PREPARED = "the prepared robot"
GRAVITY = 9.81  # m/s2
CORNER_RADIUS = 0.002  # m
DARKEST = 0.35  # colours are lightened, so that black robots can be seen
DIGITS = 5  # of the vertices of meshes [m]
# Drives, per Nm of torque limit, as TULip's.
ARMATURE, DAMPING, FRICTION = 0.003, 0.04, 0.05  # kg m2, Nm s, Nm
STRENGTH = 0.4  # torque limit over weight times length of a leg, where the file gives none
MOST_STRENGTH = 100.0  # times as much: a number that stands for no limit
UNLIMITED = np.radians(90.0)  # either way, for hinges without limits
WIDEST = np.pi + 0.01  # rad: files round
# Planning, of a leg's length, unless deg; chosen so that legs of ordinary humanoids reach most of it.
STEP, APART, TOGETHER, SINK = 0.15, 0.15, 0.05, 0.12
YAW, TORSO_YAW, TORSO_PITCH, TORSO_ROLL = 20.0, 15.0, (-5.0, 20.0), 10.0  # deg
STABILITY, SOLE = 0.2, 0.15  # of a sole's width
CELL = 0.009  # of the weight, as TULip's
ROOM = 0.01  # m, between the soles
FREE, MOST_FREE = 0.25, 40.0  # of the range of a joint that is not between the feet, either way; deg
LEAST_CHAIN = 12  # hinges between the feet


@dataclass(frozen=True)
class ImportedRobot:
    """The result of importing a published robot.

    Attributes:
        found: what the file says, by name.
        assumed: what it does not say, one sentence each. problems: what may go wrong.
        model: the robot as MJCF text. description: its description as TOML text.
    """

    found: dict[str, Any]
    assumed: tuple[str, ...]
    problems: tuple[str, ...]
    model: str
    description: str

    def write(self, out: Path, picture: Callable[[Robot], bytes | None] | None = None) -> Robot:
        """Write robot.toml, robot.xml and, if there is one, a picture into a new folder; load the robot."""
        with new_folder(out) as folder:
            write_text(folder / "robot.xml", self.model)
            write_text(folder / DESCRIPTION, self.description)
            drawn = None if picture is None else picture(load_robot(folder / DESCRIPTION))
            if drawn is not None:
                write_bytes(folder / "robot.png", drawn)
        return load_robot(Path(out) / DESCRIPTION)


def import_robot(path: Path, feet: Sequence[str] = (), sole: Sequence[float] = ()) -> ImportedRobot:
    """Prepare a published robot; see `tulip_testbed.describe_robot`."""
    path = Path(path)
    problems: tuple[str, ...] = ()
    try:
        source = read_published(path)
        problems = source.problems
        return _imported(path, source, tuple(feet), tuple(sole))
    except InputError as error:  # perhaps for want of what could not be read
        where = "" if str(path) in str(error) else f"{path}: "
        raise InputError("; ".join((f"{where}{error}", *problems))) from None


def _imported(
    path: Path, source: SourceFile, feet: tuple[str, ...], sole: tuple[float, ...]
) -> ImportedRobot:
    name, assumed, skeleton = path.stem, list(source.assumed), skeleton_of(source)
    named = None if not feet else (feet[0], feet[1])
    toes = stance_of(skeleton, named, sole).toes
    if toes:
        assumed.append(f"fixed: toes: {listed(sorted(toes))}")
        skeleton = skeleton_of(source, toes)
    beyond, least = skeleton.model.body_subtreemass, LIGHT * skeleton.mass
    if light := skeleton.hinges([link for link in skeleton.links if beyond[link] < least]):
        assumed.append(f"fixed: joints that move less than {100 * LIGHT:g} % of the mass: {listed(light)}")
        skeleton = skeleton_of(source, {*toes, *light})
    stance = stance_of(skeleton, named, sole)
    first, second = (skeleton.path(foot.link) for foot in stance.feet)
    for leg, foot in ((first - second, stance.feet[0]), (second - first, stance.feet[1])):
        if len(hinges := skeleton.hinges(leg)) < LEAST_CHAIN // 2:
            raise InputError(
                f"the leg of foot '{skeleton.name(foot.link)}' has {len(hinges)} hinges "
                f"({listed(hinges)}), expected six or more: with fewer a foot cannot stand level wherever "
                "the other one and the torso are"
            )
    if stance.turned:
        assumed.append(
            "frames turned to x forward, y left, z up (parameters are given in these): "
            f"{listed(stance.turned)}"
        )
    if sole:
        assumed.append("soles as stated")
    # Drives need the length of the legs, which the robot with any drives tells.
    stand = _stand(compose(name, skeleton, stance, source.torque, 1.0)[0], skeleton, stance, source.reference)
    spec, of_drives = compose(name, skeleton, stance, source.torque, stand.leg)
    spec.add_key(name="stand", qpos=stand.qpos)
    chain = skeleton.hinges(first ^ second)
    free = [hinge for hinge in skeleton.hinges() if hinge not in chain]
    planning = planning_table(compile_spec(spec.copy(), PREPARED), stance, stand, free)
    return ImportedRobot(
        found={
            "links": len(skeleton.links),
            "joints": len(skeleton.hinges()),
            "mass": skeleton.mass,
            "root": skeleton.name(1),
            "feet": [skeleton.name(foot.link) for foot in stance.feet],
            "soles": [np.round(foot.corners, 4).tolist() for foot in stance.feet],
            "leg": stand.leg,
            "height": stand.height,
            "between_feet": chain,
            "others": free,
            "torque": {motor.name: float(motor.forcerange[1]) for motor in spec.actuators},
            "stand": np.round(stand.qpos, 5).tolist(),
        },
        assumed=(*assumed, *of_drives),
        problems=source.problems,
        model=xml_of(spec, PREPARED),
        description=description(name, path, skeleton, stance, planning),
    )


def _stand(spec: mujoco.MjSpec, skeleton: Skeleton, stance: Stance, reference: dict[str, float]) -> Standing:
    """Find the posture `stand` of a robot whose links may be anywhere."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder).resolve() / DESCRIPTION
        write_text(path.with_suffix(".xml"), xml_of(spec, PREPARED))
        write_text(path, description("robot", path, skeleton, stance))
        try:
            robot = load_robot(path)
        except InputError as error:
            raise InputError(str(error).replace(f"{path.with_suffix('.xml')}: ", "")) from None
        pairs = unjoined_pairs(robot)
    right, left = (foot.corners.mean(axis=0) for foot in stance.feet)
    return standing(robot, (right, left), reference, lambda q: clearances_at(pairs, q, NEAR).distance)


def compose(
    name: str, skeleton: Skeleton, stance: Stance, torques: dict[str, float], leg: float
) -> tuple[mujoco.MjSpec, list[str]]:
    """Return the robot alone: links, hinges with complete drives, motors, shapes and sole corners.

    Args:
        torques: limits that the file gives, by joint [Nm]. leg: its length [m].

    Returns:
        the robot; what was assumed of its drives.
    """
    frames = {1: (skeleton.pose(1)[0], stance.axes)} | {f.link: (f.origin, f.axes) for f in stance.feet}
    spec = tree_spec(skeleton.model, skeleton.data, 1, skeleton.hinges(), frames, DIGITS)
    spec.modelname = name
    for geom in spec.geoms:
        geom.rgba = [*(DARKEST + (1 - DARKEST) * geom.rgba[:3]), 1.0]
    assumed = _complete_drives(spec, torques, STRENGTH * skeleton.mass * GRAVITY * leg)
    for foot in stance.feet:
        body = spec.body(skeleton.name(foot.link))
        for corner, (x, y, z) in zip(CORNERS, foot.corners, strict=True):
            body.add_geom(
                name=f"{body.name}_{corner}",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[CORNER_RADIUS, 0, 0],
                pos=[x, y, z + CORNER_RADIUS],
                rgba=[0.1, 0.1, 0.1, 1],
                group=3,
                contype=1,
                conaffinity=0,
                mass=0.0,
            )
    return spec, assumed


def _complete_drives(spec: mujoco.MjSpec, torques: dict[str, float], usual: float) -> list[str]:
    """Complete all hinges, give each a motor, and return what was assumed."""
    hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    lacking: dict[str, list[str]] = {
        f"torque limit {usual:.3g} Nm ({STRENGTH:g} of the weight times the leg's length)": [],
        f"torque limit {usual:.3g} Nm instead of the file's, over {MOST_STRENGTH:g} times as much": [],
        f"rotor inertia {ARMATURE:g} kg m2 per Nm of torque limit": [],
        f"damping {DAMPING:g} Nm s per Nm of torque limit": [],
        f"dry friction {FRICTION:g} of the torque limit": [],
        f"range of {np.degrees(UNLIMITED):g} deg either way": [],
        "range of 180 deg either way instead of the file's wider one": [],
    }
    for hinge in hinges:
        given = torques.get(hinge.name, 0.0)
        boundless = given > MOST_STRENGTH * usual
        torque = usual if boundless or not given else given
        limited = hinge.limited == mujoco.mjtLimited.mjLIMITED_TRUE
        weak, loose = hinge.armature < LEAST_ARMATURE * torque, hinge.damping[0] <= 0
        slick, wide = hinge.frictionloss <= 0, limited and max(np.abs(hinge.range)) > WIDEST
        lacks = (not given, boundless, weak, loose, slick, not limited, wide)
        for names, lack in zip(lacking.values(), lacks, strict=True):
            names += [hinge.name] * bool(lack)
        hinge.armature = ARMATURE * torque if weak else hinge.armature
        hinge.damping = [DAMPING * torque if loose else hinge.damping[0], 0, 0]
        hinge.frictionloss = FRICTION * torque if slick else hinge.frictionloss
        hinge.range = np.clip(hinge.range, -np.pi, np.pi) if limited else [-UNLIMITED, UNLIMITED]
        hinge.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        hinge.solref_friction, hinge.solimp_friction = SOLREF_FRICTION, SOLIMP_FRICTION
        motor = spec.add_actuator(name=hinge.name, target=hinge.name, gear=[1, 0, 0, 0, 0, 0])
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.forcelimited, motor.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-torque, torque]
    return [
        f"{words} for {'all joints' if len(names) == len(hinges) else listed(names)}"
        for words, names in lacking.items()
        if names
    ]


def description(name: str, path: Path, skeleton: Skeleton, stance: Stance, planning: str = "") -> str:
    """Return the description of a robot as TOML; path: of the published file."""
    right, left = (skeleton.name(foot.link) for foot in stance.feet)
    return (
        f"# Prepared by `tulip robot` from {printable(path.name)}; everything here can be edited.\n"
        f"name = {json.dumps(name)}\n"
        'model = "robot.xml"         # the robot alone: links, hinges, motors, sole corners, keyframe stand\n'
        f"stance_foot = {json.dumps(right)}\n"
        f"swing_foot = {json.dumps(left)}\n\n{planning}"
    )


def planning_table(model: mujoco.MjModel, stance: Stance, standing: Standing, free: list[str]) -> str:
    """Return the [planning] table of a description; free: joints that are not between the feet."""
    leg, corners, spacing = standing.leg, stance.feet[0].corners, standing.spacing
    width, weight = float(np.ptp(corners[:, 1])), float(model.body_mass.sum()) * GRAVITY
    inner = float(corners[:, 1].max() - stance.feet[1].corners[:, 1].min())
    nearest = max(inner + ROOM, spacing - TOGETHER * leg)
    farthest = max(spacing + APART * leg, nearest + 0.5 * APART * leg)
    lines = [
        "[planning]                  # ranges from which postures are drawn, and the margins that they keep",
        f"swing_x = [{-STEP * leg:.3f}, {STEP * leg:.3f}]    # swing foot from the stance foot [m]",
        f"swing_y = [{nearest:.3f}, {farthest:.3f}]",
        f"swing_yaw_deg = [{-YAW:g}, {YAW:g}]",
        f"torso_yaw_deg = [{-TORSO_YAW:g}, {TORSO_YAW:g}]       # the free body",
        f"torso_pitch_deg = [{TORSO_PITCH[0]:g}, {TORSO_PITCH[1]:g}]",
        f"torso_roll_deg = [{-TORSO_ROLL:g}, {TORSO_ROLL:g}]",
        f"least_height = {standing.height - SINK * leg:.3f}        # of the free body over the soles [m]",
        f"stability_margin = {STABILITY * width:.4f}   # centre of mass inside the support polygon [m]",
        "foot_clearance = 0.0",
        f"sole_margin = {SOLE * width:.4f}        # each foot's CoP inside its sole [m]",
        f"least_cell_load = {CELL * weight:.2f}     # on each of the eight cells [N]",
    ]
    if free:
        lines += ["", "[planning.joints_deg]       # joints that are not between the feet"]
    for joint in map(model.joint, free):
        at = float(np.degrees(standing.qpos[joint.qposadr[0]]))
        low, high = np.degrees(joint.range)
        reach = min(FREE * (high - low), MOST_FREE)
        least, most = max(float(low), at - reach), min(float(high), at + reach)
        # Within the range, as written.
        within = f"[{np.ceil(10 * least + 0.1) / 10:.1f}, {np.floor(10 * most - 0.1) / 10:.1f}]"
        lines.append(f"{json.dumps(joint.name)} = {within}")
    return "\n".join(lines) + "\n"
