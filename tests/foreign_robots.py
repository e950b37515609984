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

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.robot_import.feet import Foot, Stance
from tulip_testbed.experiments.robot_import.robot_import import compose
from tulip_testbed.experiments.robot_import.skeleton import Skeleton
from tulip_testbed.sim.robot import load_spec
from tulip_testbed.sim.specs import compile_spec

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
    """The robot alone, composed as an import does it, with soles and posture as they are stated here."""
    about, model = ROBOTS[name], original_model(name)
    for ours in (model.dof_armature, model.dof_damping, model.dof_frictionloss):
        ours[:] = 0
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    skeleton = Skeleton(model, data)

    def axes(link: int) -> np.ndarray:
        return skeleton.pose(link)[1] @ about.turned.get(skeleton.name(link), np.eye(3))

    feet = []
    rear, front, outer, inner, bottom = about.sole
    for foot, mirror in zip(about.feet, (1, -1), strict=True):
        link, (right, left) = model.body(foot).id, sorted((mirror * outer, mirror * inner))
        corners = [[front, left], [front, right], [rear, right], [rear, left]]
        corners = np.column_stack([corners, np.full(4, bottom)])
        feet.append(Foot(link, axes(link), skeleton.pose(link)[0], corners))
    limits = model.actuator_gear[:, 0] * model.actuator_ctrlrange[:, 1]
    names = [model.joint(joint).name for joint in model.actuator_trnid[:, 0]]
    torques = dict(zip(names, limits.tolist(), strict=True))
    stance = Stance((feet[0], feet[1]), axes(1), frozenset(), ())
    spec, _ = compose(name, skeleton, stance, torques, 1.0)
    stand = spec.copy().compile()
    qpos = stand.qpos0.copy()
    for joint, angle in about.stand.items():
        qpos[stand.joint(joint).qposadr[0]] = angle
    spec.add_key(name="stand", qpos=qpos)
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
