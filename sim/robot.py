"""The robot: its description (TOML) and its compiled MJCF, loaded once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, choices, listed, look_up, shortened
from tulip_testbed.base.files import check_path, present, read_toml, sha256
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.mjcf_files import mjcf_files
from tulip_testbed.sim.model_check import check_before_compiling, check_model
from tulip_testbed.sim.sandbox import try_to_compile
from tulip_testbed.sim.shipped import PLATE, TULIP
from tulip_testbed.sim.specs import compile_spec, read_spec, without_meshes

KEYS = (
    *("name", "model", "scene", "plate", "stance_foot", "swing_foot"),
    *("z_down", "simplified", "correlated", "residual_sigma_mm", "planning", "paper"),
    *("drives", "compliance"),
)
DESCRIBED = ("scene_file", "plate_file", "stance_foot", "swing_foot", "settings")  # fields not compiled
STAND = "stand"  # the keyframe where inverse kinematics starts
DESCRIPTION = "robot.toml"  # in a folder that `tulip robot` writes
PUBLISHED = (".urdf", ".xml")  # endings of models as people publish them

# MuJoCo would write its warnings to a file in the working directory; `Stand` counts those of a posture.
mujoco.set_mju_user_warning(lambda message: None)


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A robot, loaded once and passed on: its description, compiled model and file hashes.

    It is what its files held when it was loaded. Pickling stores the path of the description; the other
    process loads the robot once and refuses it if a file has changed since.

    Attributes:
        path: the description (TOML).
        model_file: MJCF of the robot alone.
        scene_file: MJCF of the robot on two plates; None builds the scene from the robot and `plate_file`.
        plate_file: MJCF of one plate.
        stance_foot, swing_foot: body names; the plate under the stance foot is the right one.
        settings: the whole description.
        hashes: SHA-256 of the description and of every file that the MJCF consist of, by name in the robot's
            folder; the description comes first.
        model_hash: SHA-256 of the MJCF of the robot alone, its includes and meshes.
        spec: the robot alone without meshes that only a viewer needs; copy it before editing.
        model: `spec`, compiled.
        meshes: whether `spec` and `model` contain the meshes for drawing.
    """

    path: Path
    model_file: Path
    scene_file: Path | None
    plate_file: Path
    stance_foot: str
    swing_foot: str
    settings: dict[str, Any] = field(repr=False)
    hashes: dict[str, str] = field(repr=False)
    model_hash: str = field(repr=False)
    spec: mujoco.MjSpec = field(repr=False)
    model: mujoco.MjModel = field(repr=False)
    meshes: bool = False

    def __repr__(self) -> str:
        mass = float(self.model.body_mass.sum())
        return f"Robot {self.name}: {len(joint_names(self.model))} joints, {mass:.2f} kg ({self.path.name})"

    @property
    def folder(self) -> Path:
        """Return the folder of the robot's files."""
        return self.path.parent

    @property
    def name(self) -> str:
        """Return the name in the description, or else that of the model file."""
        return self.settings.get("name", self.model_file.stem)

    @property
    def feet(self) -> tuple[str, str]:
        """Return stance and swing foot, in the order of `PLATES`."""
        return self.stance_foot, self.swing_foot

    @property
    def sole_geoms(self) -> tuple[str, ...]:
        """Return the names of the sole corners of both feet, in the order of `CORNERS`."""
        return tuple(f"{foot}_{corner}" for foot in self.feet for corner in CORNERS)

    @property
    def files(self) -> list[Path]:
        """List the description and the MJCF files that it names."""
        return [self.path, self.model_file, self.scene_file or self.plate_file]

    @cached_property
    def visual_model(self) -> mujoco.MjModel:
        """Return the model of the robot alone with all its geometry."""
        whole = read_spec(self.model_file)
        return self.model if not whole.meshes else compile_spec(whole, str(self.model_file))

    def __deepcopy__(self, memo: dict[int, Any]) -> Robot:
        return self

    def __reduce__(self) -> tuple[Callable[..., Robot], tuple[Any, ...]]:
        described = {name: getattr(self, name) for name in DESCRIBED}
        return _elsewhere, (self.path, tuple(self.hashes.items()), described)


def load_robot(path: Path = TULIP, meshes: bool = False) -> Robot:
    """Load a robot: read its description, compile its model, check its feet.

    Args:
        path: the description (TOML), or the folder in which `tulip robot` has written it.
        meshes: keep meshes without contacts, for drawing.
    """
    inside = Path(path) / DESCRIPTION
    if Path(path).is_dir() and not present(inside):
        raise InputError(f"{path}: found a folder without {DESCRIPTION}, expected that of `tulip robot`")
    return _load(inside if present(inside) else Path(path), meshes, new=True)


def _elsewhere(path: Path, hashes: tuple[tuple[str, str], ...], described: dict[str, Any]) -> Robot:
    """Restore a robot in another process, where its files are read once."""
    robot = _reloaded(path, hashes)
    same = all(getattr(robot, name) == value for name, value in described.items())
    return robot if same else replace(robot, **described)


@lru_cache(maxsize=8)
def _reloaded(path: Path, hashes: tuple[tuple[str, str], ...]) -> Robot:
    robot = _load(path, meshes=False, new=False)  # the first process has compiled it safely
    if tuple(robot.hashes.items()) != hashes:
        raise InputError(f"{path}: a file of the robot was changed while it was in use")
    return robot


def _load(path: Path, meshes: bool, new: bool) -> Robot:
    settings = _description(path)
    path = Path(os.path.realpath(path))
    check_path(path)  # the folder's names too: MuJoCo reads UTF-8 alone
    folder = path.parent
    model_file, feet = folder / settings["model"], (settings["stance_foot"], settings["swing_foot"])
    scene_file = folder / settings["scene"] if "scene" in settings else None
    plate_file = folder / settings.get("plate", PLATE)
    files = {model_file: _files(model_file, folder)}
    with suppress(InputError):  # a broken scene is refused by what stands on it
        files[scene_file or plate_file] = _files(scene_file or plate_file, folder)
    if new:
        try_to_compile(model_file, files)
    spec = read_spec(model_file)
    check_before_compiling(spec, str(model_file))
    spec = spec if meshes else without_meshes(spec, str(model_file))
    model = compile_spec(spec.copy(), str(model_file))
    check_model(model, str(model_file))
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    for foot in feet:
        look_up("foot", foot, bodies, str(model_file))
        try:
            sole_corners(model, foot)
        except InputError as error:
            raise InputError(f"{model_file}: {error}") from None
    return Robot(
        path=path,
        model_file=model_file,
        scene_file=scene_file,
        plate_file=plate_file,
        stance_foot=feet[0],
        swing_foot=feet[1],
        settings=settings,
        hashes={path.name: sha256(path)}
        | {n: h for found in files.values() for n, h in _named(found, folder)},
        model_hash=_joint_hash(_named(files[model_file], folder)),
        spec=spec,
        model=model,
        meshes=meshes,
    )


def _description(path: Path) -> dict[str, Any]:
    if path.suffix.lower() in PUBLISHED and present(path):
        raise InputError(
            f"{path}: found a model, expected a description (TOML): `tulip robot` makes one of it"
        )
    settings = read_toml(path)
    if unknown := [key for key in settings if key not in KEYS]:
        raise InputError(f"{path}: unknown key '{unknown[0]}'; {choices(unknown[0], KEYS)}")
    optional = [key for key in ("scene", "plate") if key in settings]
    for key in ("model", "stance_foot", "swing_foot", *optional):
        if not isinstance(settings.get(key), str):
            found = repr(settings[key]) if key in settings else "nothing"
            raise InputError(f"{path}: key '{key}': found {found}, expected a text")
    if len(optional) == 2:
        raise InputError(
            f"{path}: found keys 'scene' and 'plate', expected one: a scene holds its own plates"
        )
    return settings


def load_spec(path: Path, folder: Path | None = None) -> mujoco.MjSpec:
    """Parse an MJCF after a separate process has compiled it, with files of a folder; None: of its own."""
    path = Path(path)
    try_to_compile(path, {path: _files(path, folder or path.parent)})
    return read_spec(path)


def check_unchanged(robot: Robot, path: Path) -> None:
    """Refuse an MJCF of a robot of which a file was changed since the robot was loaded."""
    for name, now in _named(_files(path, robot.folder), robot.folder):
        if robot.hashes.get(name, now) != now:
            raise InputError(f"{robot.path}: {name} was changed while the robot was in use; load it again")


def _files(path: Path, folder: Path) -> dict[Path, str]:
    """Return the files that an MJCF of a robot consists of, with their hashes."""
    if not present(path):
        raise InputError(f"{path}: no such MJCF file")
    return mjcf_files(path, path.parent if path == PLATE else folder)


def _named(files: Mapping[Path, str], folder: Path) -> list[tuple[str, str]]:
    return [
        (path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name, found)
        for path, found in files.items()
    ]


def _joint_hash(files: list[tuple[str, str]]) -> str:
    """Return the hash of a file, or one for several files with their names."""
    if len(files) == 1:
        return files[0][1]
    return hashlib.sha256("".join(f"{name} {found}\n" for name, found in sorted(files)).encode()).hexdigest()


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """List the robot's hinge joints in the model's order."""
    return tuple(
        model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
    )


def between_feet(model: mujoco.MjModel, robot: Robot) -> np.ndarray:
    """Return which hinges lie between the feet and form a closed chain, (n_joints,) bool."""
    paths = [set(bodies_to_root(model, model.body(foot).id)) for foot in robot.feet]
    bodies = paths[0] ^ paths[1]
    return np.array([int(model.joint(name).bodyid[0]) in bodies for name in joint_names(model)])


def joint_ranges(model: mujoco.MjModel) -> np.ndarray:
    """Return the limits of the hinges, infinite where there are none, (n_joints, 2) [rad]."""
    joints = [model.joint(name) for name in joint_names(model)]
    return np.array([j.range if j.limited[0] else [-np.inf, np.inf] for j in joints]).reshape(-1, 2)


def sole_corners(model: mujoco.MjModel, foot: str) -> np.ndarray:
    """Return the corners of a foot's sole in the foot's frame, in the order of `CORNERS`, (4, 3) [m]."""
    wanted = [f"{foot}_{corner}" for corner in CORNERS]
    if missing := [n for n in wanted if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, n) < 0]:
        raise InputError(
            f"foot '{shortened(foot)}' lacks the sole corners (geoms) {shortened(listed(missing), 300)}"
        )
    corners = np.array([model.geom(name).pos for name in wanted])
    corners[:, 2] -= [model.geom(name).size[0] for name in wanted]
    x, y = corners[:, 0], corners[:, 1]
    if min(x[:2]) <= max(x[2:]) or min(y[[0, 3]]) <= max(y[[1, 2]]):
        raise InputError(
            f"foot '{shortened(foot)}': found the sole corners {listed(CORNERS)} at (x, y) = "
            f"{listed(map(tuple, np.round(corners[:, :2], 4).tolist()))} m in its frame, "
            "expected x forward and y to the left"
        )
    return corners


def sole_point(model: mujoco.MjModel, foot: str) -> np.ndarray:
    """Return the point of the sole below the foot's origin (its ankle), in the foot's frame, (3,) [m]."""
    heights = sole_corners(model, foot)[:, 2]
    if np.ptp(heights) > 1e-6:
        found = listed(np.round(heights, 6))
        raise InputError(
            f"foot '{shortened(foot)}': found sole corners at heights {found} m in its frame, "
            "expected one height (the frame's z is the sole's normal)"
        )
    return np.array([0.0, 0.0, heights.mean()])


def standing(model: mujoco.MjModel) -> np.ndarray:
    """Return the configuration of the keyframe `stand`, or the zero pose if there is none, (nq,)."""
    keys = [model.key(k).name for k in range(model.nkey)]
    return (model.key(STAND).qpos if STAND in keys else model.qpos0).copy()


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotations of quaternions, (k, 4) -> (k, 3, 3)."""
    matrices = np.zeros((len(quaternions), 9))
    for matrix, unit in zip(matrices, quaternions, strict=True):
        mujoco.mju_quat2Mat(matrix, unit)
    return matrices.reshape(-1, 3, 3)


def quaternion(turn: np.ndarray) -> np.ndarray:
    """Return the unit quaternion of a rotation matrix, (4,)."""
    unit = np.zeros(4)
    mujoco.mju_mat2Quat(unit, np.ascontiguousarray(turn).ravel())
    return unit


def bodies_to_root(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """Yield the numbers of a body and of those above it, up to the free body."""
    while body:
        yield body
        body = int(model.body_parentid[body])
