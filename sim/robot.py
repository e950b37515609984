"""Load a robot: its description (TOML) and its MJCF models, edited by name through MjSpec."""

from __future__ import annotations

import hashlib
import tomllib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.sim.errors import InputError, listed, look_up, shortened
from tulip_testbed.sim.files import present, read_bytes, read_text
from tulip_testbed.sim.mjcf_files import mjcf_files
from tulip_testbed.sim.model_check import check_model
from tulip_testbed.sim.sandbox import try_to_compile

ASSETS = Path(__file__).resolve().parent.parent / "assets"
TULIP = ASSETS / "tulip_mjcf" / "tulip.toml"
PLATE = ASSETS / "tulip_mjcf" / "plate.xml"

KEYS = (
    *("name", "model", "scene", "plate", "stance_foot", "swing_foot"),
    *("z_down", "simplified", "correlated", "residual_sigma_mm", "planning", "paper"),
    *("drives", "compliance"),
)
MOST_TOML = 2**20  # bytes
BROKEN = (
    ValueError,
    RuntimeError,
    mujoco.FatalError,
    mujoco.UnexpectedError,
)  # what MuJoCo's compiler raises
CORNERS = ("front_left", "front_right", "rear_right", "rear_left")
PLATES = ("right", "left")
CELLS = tuple(f"{plate}.{corner}" for plate in PLATES for corner in CORNERS)

# MuJoCo would write its warnings into a file where we stand; what they mean for a posture, `Stand` counts.
mujoco.set_mju_user_warning(lambda message: None)


@dataclass(frozen=True)
class Robot:
    """A robot's files and the few facts that MJCF cannot say.

    Attributes:
        path: the description (TOML).
        model: MJCF of the robot alone.
        scene: MJCF of the robot on two plates; None: built from `model` and `plate`.
        stance_foot, swing_foot: body names; the plate under the stance foot is the right one.
        settings: the whole description.
        plate: MJCF of one plate.
    """

    path: Path
    model: Path
    scene: Path | None
    stance_foot: str
    swing_foot: str
    settings: dict[str, Any] = field(repr=False)
    plate: Path = PLATE

    @property
    def folder(self) -> Path:
        """Where its files lie."""
        return self.path.resolve().parent

    @property
    def feet(self) -> tuple[str, str]:
        """Stance and swing foot, in the order of `PLATES`."""
        return self.stance_foot, self.swing_foot

    @property
    def files(self) -> list[Path]:
        """The description and the MJCF files that it names."""
        return [self.path, self.model, self.scene or self.plate]


def load_robot(path: Path = TULIP) -> Robot:
    """Read a robot description.

    Raises:
        InputError: the file is missing, is not TOML, or lacks a key.
    """
    path = Path(path)
    try:
        settings = tomllib.loads(read_text(path, MOST_TOML))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a TOML file ({error})") from None
    except RecursionError:
        raise InputError(f"{path}: not a robot description: nested too deep") from None
    if unknown := [key for key in settings if key not in KEYS]:
        raise InputError(f"{path}: unknown key '{unknown[0]}'; valid: {listed(KEYS)}")
    optional = [key for key in ("scene", "plate") if key in settings]
    for key in ("model", "stance_foot", "swing_foot", *optional):
        if not isinstance(settings.get(key), str):
            found = repr(settings[key]) if key in settings else "nothing"
            raise InputError(f"{path}: key '{key}': found {found}, expected a text")
    if len(optional) == 2:
        raise InputError(
            f"{path}: found keys 'scene' and 'plate', expected one: a scene holds its own plates"
        )
    folder = path.resolve().parent
    return Robot(
        path,
        folder / settings["model"],
        folder / settings["scene"] if "scene" in settings else None,
        settings["stance_foot"],
        settings["swing_foot"],
        settings,
        folder / settings.get("plate", PLATE),
    )


def load_spec(path: Path, folder: Path | None = None) -> mujoco.MjSpec:
    """Parse an MJCF file.

    Args:
        folder: of the robot, which it may read files from; its own if None.

    Raises:
        InputError: the file is missing, is no MJCF, or reads files outside of the folder.
    """
    path = Path(path)
    if not present(path):
        raise InputError(f"{path}: no such MJCF file")
    try_to_compile(path, mjcf_files(path, folder or path.parent))
    try:
        return mujoco.MjSpec.from_file(str(path))
    except BROKEN as error:
        raise InputError(f"{path}: broken MJCF: {shortened(error, 300)}") from None


def compile_spec(spec: mujoco.MjSpec, where: str) -> mujoco.MjModel:
    """Compile, with the compiler's complaint as the message of an `InputError`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what MuJoCo doubts, `check_model` refuses by name
            return spec.compile()
    except BROKEN as error:
        raise InputError(f"{where}: broken MJCF: {shortened(error, 300)}") from None


def load_model(robot: Robot) -> mujoco.MjModel:
    """Compile the robot alone and check that it names the two feet.

    Raises:
        InputError: broken MJCF, an unknown foot, a foot without its four sole corners.
    """
    model = compile_spec(load_spec(robot.model, robot.folder), str(robot.model))
    check_model(model, str(robot.model))
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    for foot in robot.feet:
        look_up("foot", foot, bodies, str(robot.model))
        try:
            sole_corners(model, foot)
        except InputError as error:
            raise InputError(f"{robot.model}: {error}") from None
    return model


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """The robot's hinge joints in the model's order."""
    return tuple(
        model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
    )


def between_feet(model: mujoco.MjModel, robot: Robot) -> np.ndarray:
    """Which hinges lie between the feet, so that standing on both couples them, (n_joints,) bool."""
    paths = [set(_to_root(model, model.body(foot).id)) for foot in robot.feet]
    bodies = paths[0] ^ paths[1]
    return np.array([int(model.joint(name).bodyid[0]) in bodies for name in joint_names(model)])


def joint_ranges(model: mujoco.MjModel) -> np.ndarray:
    """Limits of the hinges, infinite where there are none, (n_joints, 2) [rad]."""
    joints = [model.joint(name) for name in joint_names(model)]
    return np.array([j.range if j.limited[0] else [-np.inf, np.inf] for j in joints]).reshape(-1, 2)


def sole_corners(model: mujoco.MjModel, foot: str) -> np.ndarray:
    """Corners of a foot's sole in the foot's frame, (4, 3) [m], in the order of `CORNERS`.

    Raises:
        InputError: a geom FOOT_CORNER is missing, or the foot's x does not point forward.
    """
    wanted = [f"{foot}_{corner}" for corner in CORNERS]
    if missing := [n for n in wanted if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, n) < 0]:
        raise InputError(f"foot '{foot}' lacks the sole corners (geoms) {listed(missing)}")
    corners = np.array([model.geom(name).pos for name in wanted])
    corners[:, 2] -= [model.geom(name).size[0] for name in wanted]
    x, y = corners[:, 0], corners[:, 1]
    if min(x[:2]) <= max(x[2:]) or min(y[[0, 3]]) <= max(y[[1, 2]]):
        raise InputError(
            f"foot '{foot}': found the sole corners {listed(CORNERS)} at (x, y) = "
            f"{listed(map(tuple, np.round(corners[:, :2], 4).tolist()))} m in its frame, "
            "expected x forward and y to the left"
        )
    return corners


def sole_point(model: mujoco.MjModel, foot: str) -> np.ndarray:
    """The point of the sole below the foot's origin (its ankle), in the foot's frame, (3,) [m].

    Raises:
        InputError: the sole is not level in the foot's frame.
    """
    heights = sole_corners(model, foot)[:, 2]
    if np.ptp(heights) > 1e-6:
        raise InputError(
            f"foot '{foot}': found sole corners at heights {listed(np.round(heights, 6))} m in its frame, "
            "expected one height (the frame's z is the sole's normal)"
        )
    return np.array([0.0, 0.0, heights.mean()])


def sha256(path: Path) -> str:
    """Hash of a file's bytes, in hexadecimal."""
    return hashlib.sha256(read_bytes(Path(path))).hexdigest()


def _to_root(model: mujoco.MjModel, body: int) -> Iterator[int]:
    while body:
        yield body
        body = int(model.body_parentid[body])
