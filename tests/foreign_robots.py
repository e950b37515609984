"""Two humanoids that nobody here wrote, made into robots for this project.

They come with dm_control and are read from the installed package; no file of theirs is kept
here. Bodies, lengths, masses, joints with their ranges, and motors are theirs. Ours are:

- soles: four corners a foot, about as large as the shapes of the foot;
- frames with x forward, y left and z up for the free body and the feet, where theirs differ;
- the drives' rotor inertia, damping and dry friction, in proportion to the torque limit as
  TULip's are; springs in the joints are left out;
- the keyframe `stand` (knees bent) and the planning ranges.

Sensors, lights, cameras, the floor and all contacts but the soles' are left out.

"""

from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.robot import load_spec
from tulip_testbed.sim.specs import compile_spec

CORNER_RADIUS = 0.002  # m
# Per Nm of torque limit, as TULip's drives: rotor inertia, damping, dry friction.
ARMATURE, DAMPING, FRICTION = 0.003, 0.04, 0.05

# The columns are the new x, y, z axes in the old frame.
LEFT_UP_FORWARD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # old x, y, z
LEFT_BACK_UP = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Foreign:
    """What a robot's MJCF does not say.

    Attributes:
        file: MJCF within dm_control.
        feet: stance (right) and swing (left) foot.
        sole: rear, front, outer and inner edge from the right foot's origin, and height [m].
        stand: joint angles with knees bent, the others zero [rad].
        planning: the robot description's [planning] table.
        turned: new axes of bodies whose frames do not have x forward, y left, z up.
    """

    file: str
    feet: tuple[str, str]
    sole: tuple[float, float, float, float, float]
    stand: dict[str, float]
    planning: str
    turned: dict[str, np.ndarray] = field(default_factory=dict)


ROBOTS = {
    "humanoid": Foreign(
        file="suite/humanoid.xml",
        feet=("right_foot", "left_foot"),
        sole=(-0.09, 0.16, -0.065, 0.045, -0.027),
        stand={
            f"{side}_{joint}": angle
            for side in ("right", "left")
            for joint, angle in (("hip_y", -0.2), ("knee", -0.4), ("ankle_y", -0.2))
        },
        planning="""\
swing_x = [-0.1, 0.1]
swing_y = [0.16, 0.24]
swing_yaw_deg = [-25, 25]
torso_yaw_deg = [-20, 20]
torso_pitch_deg = [-15, 35]
torso_roll_deg = [-20, 20]
least_height = 1.05          # torso over sole; 1.285 standing straight
stability_margin = 0.04
foot_clearance = 0.0
sole_margin = 0.03
least_cell_load = 2.0

[planning.joints_deg]
abdomen_z = [-25, 25]
abdomen_y = [-30, 15]
abdomen_x = [-15, 15]
""",
    ),
    "humanoid_CMU": Foreign(
        file="suite/humanoid_CMU.xml",
        feet=("rfoot", "lfoot"),
        sole=(-0.055, 0.135, -0.045, 0.045, -0.053),
        stand={
            **{
                f"{side}{joint}": angle
                for side in "rl"
                for joint, angle in (("femurrx", -0.2), ("tibiarx", 0.4), ("footrx", -0.2))
            },
            "rfemurrz": 0.344,
            "lfemurrz": -0.344,
        },
        turned={"root": LEFT_UP_FORWARD, "rfoot": LEFT_BACK_UP, "lfoot": LEFT_BACK_UP},
        planning="""\
swing_x = [-0.1, 0.1]
swing_y = [0.17, 0.22]
swing_yaw_deg = [-20, 20]
torso_yaw_deg = [-15, 15]
torso_pitch_deg = [-10, 25]
torso_roll_deg = [-4, 4]
least_height = 0.75
stability_margin = 0.045
foot_clearance = 0.0
sole_margin = 0.035
least_cell_load = 2.0

[planning.joints_deg]        # toes up only: down, they would push into the board
rtoesrx = [-20, 0]
ltoesrx = [-20, 0]
""",
    ),
}


def foreign_robot(name: str) -> mujoco.MjSpec:
    """The robot alone, as this project wants it, built anew from the compiled original."""
    about = ROBOTS[name]
    old = original_model(name)
    turns = [about.turned.get(old.body(i).name, np.eye(3)) for i in range(old.nbody)]
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    bodies = [spec.worldbody]
    for i in range(1, old.nbody):
        bodies.append(_add_body(bodies[old.body_parentid[i]], old, i, turns))
    for i in range(old.nu):
        _add_motor(spec, old, i)
    for foot, mirror in zip(about.feet, (1, -1), strict=True):
        _add_sole(spec.body(foot), about.sole, mirror)
    _add_stand(spec, about)
    return spec


def write_robot(name: str, folder: Path) -> Path:
    """Write robot.xml and robot.toml into a new or empty folder; returns the description's path.

    Raises:
        InputError: the folder holds something already.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder}: exists already, expected a new folder")
    spec, about = foreign_robot(name), ROBOTS[name]
    spec.compile()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(spec.to_xml(), encoding="utf-8")
    (folder / "robot.toml").write_text(
        f'name = "{name}"\nmodel = "robot.xml"\n'
        f'stance_foot = "{about.feet[0]}"\nswing_foot = "{about.feet[1]}"\n\n[planning]\n{about.planning}',
        encoding="utf-8",
    )
    return folder / "robot.toml"


def original_model(name: str) -> mujoco.MjModel:
    """The robot as dm_control has it, compiled.

    Raises:
        InputError: dm_control is not installed.
    """
    package = find_spec("dm_control")
    if package is None or package.origin is None:
        raise InputError("dm_control is not installed, expected it beside this project")
    source = Path(package.origin).parent / ROBOTS[name].file
    return compile_spec(load_spec(source), str(source))


def _add_body(parent: mujoco.MjsBody, old: mujoco.MjModel, i: int, turns: list[np.ndarray]) -> mujoco.MjsBody:
    before, turn = turns[old.body_parentid[i]], turns[i]
    body = parent.add_body(
        name=old.body(i).name,
        pos=before.T @ old.body_pos[i],
        quat=_quaternion(before.T @ _rotation(old.body_quat[i]) @ turn),
        mass=old.body_mass[i],
        ipos=turn.T @ old.body_ipos[i],
        iquat=_quaternion(turn.T @ _rotation(old.body_iquat[i])),
        inertia=old.body_inertia[i],
        explicitinertial=True,
    )
    for j in range(old.body_jntadr[i], old.body_jntadr[i] + old.body_jntnum[i]):
        if old.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
            body.add_freejoint(name=old.joint(j).name)
            continue
        body.add_joint(
            name=old.joint(j).name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            pos=turn.T @ old.jnt_pos[j],
            axis=turn.T @ old.jnt_axis[j],
            range=old.jnt_range[j],
            solref_friction=[0.002, 1],
            solimp_friction=[0.9999, 0.9999, 0.001, 0.5, 2],
        )
    for g in range(old.body_geomadr[i], old.body_geomadr[i] + old.body_geomnum[i]):
        body.add_geom(
            name=old.geom(g).name,
            type=mujoco.mjtGeom(old.geom_type[g]),
            size=old.geom_size[g],
            pos=turn.T @ old.geom_pos[g],
            quat=_quaternion(turn.T @ _rotation(old.geom_quat[g])),
            rgba=[0.7, 0.6, 0.5, 1],
            group=2,
            contype=0,
            conaffinity=0,
        )
    return body


def _add_motor(spec: mujoco.MjSpec, old: mujoco.MjModel, i: int) -> None:
    """A motor as it was (gear and ctrlrange), and on its joint what a drive brings with it."""
    gear, control = old.actuator_gear[i], old.actuator_ctrlrange[i]
    joint = spec.joint(old.joint(old.actuator_trnid[i, 0]).name)
    motor = spec.add_actuator(name=old.actuator(i).name, target=joint.name, gear=gear, ctrlrange=control)
    motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    torque = gear[0] * control[1]
    joint.armature, joint.frictionloss = ARMATURE * torque, FRICTION * torque
    joint.damping = [DAMPING * torque, 0, 0]


def _add_sole(foot: mujoco.MjsBody, sole: tuple[float, ...], mirror: int) -> None:
    rear, front, outer, inner, bottom = sole
    left, right = max(mirror * outer, mirror * inner), min(mirror * outer, mirror * inner)
    for corner in CORNERS:
        foot.add_geom(
            name=f"{foot.name}_{corner}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[CORNER_RADIUS, 0, 0],
            pos=[
                front if "front" in corner else rear,
                left if "left" in corner else right,
                bottom + CORNER_RADIUS,
            ],
            rgba=[0.1, 0.1, 0.1, 1],
            group=3,
            contype=1,
            conaffinity=0,
        )


def _add_stand(spec: mujoco.MjSpec, about: Foreign) -> None:
    model = spec.compile()
    qpos = model.qpos0.copy()
    for joint, angle in about.stand.items():
        qpos[model.joint(joint).qposadr[0]] = angle
    spec.add_key(name="stand", qpos=qpos)


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(rotation).as_quat(scalar_first=True)
