"""Prepare a published robot: find what the laboratory needs, and write it as a description."""

from __future__ import annotations

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
from tulip_testbed.experiments.robot_import.completed_drives import drives_of
from tulip_testbed.experiments.robot_import.compose import add_stand, compose
from tulip_testbed.experiments.robot_import.feet import Foot, Stance, stance_of
from tulip_testbed.experiments.robot_import.planning_table import planning_table
from tulip_testbed.experiments.robot_import.published import read_published
from tulip_testbed.experiments.robot_import.skeleton import Skeleton, fixed, skeleton_of
from tulip_testbed.experiments.robot_import.standing_posture import Standing, standing
from tulip_testbed.identification.link_clearances import clearances_at, link_pairs
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.specs import compile_spec

LIGHT = 0.005  # of the robot's mass: a joint that moves less is fixed
NEAR = 0.1  # m: links farther apart are not looked at
LEAST_CHAIN = 12  # hinges between the feet


@dataclass(frozen=True)
class ImportedRobot:
    """The result of importing a published robot.

    Attributes:
        name: of the robot.
        source: its file.
        found: what the file says, by name.
        assumed: what it does not say, one sentence each.
        problems: what may go wrong.
        model: the robot as MJCF text. description: its description as TOML text.
    """

    name: str
    source: Path
    found: dict[str, Any]
    assumed: tuple[str, ...]
    problems: tuple[str, ...]
    model: str
    description: str

    def plain(self) -> dict[str, Any]:
        """Return the JSON document."""
        return {"found": self.found, "assumed": list(self.assumed), "problems": list(self.problems)}

    def write(self, out: Path, picture: Callable[[Robot], bytes | None] | None = None) -> Robot:
        """Write robot.toml, robot.xml and a picture into a new folder, and load the robot.

        Args:
            picture: draws the robot as PNG, or returns None if it cannot.

        Raises:
            InputError: the folder exists or cannot be written, or the laboratory cannot take the robot.
        """
        with new_folder(out) as folder:
            write_text(folder / "robot.xml", self.model)
            write_text(folder / "robot.toml", self.description)
            drawn = None if picture is None else picture(load_robot(folder / "robot.toml"))
            if drawn is not None:
                write_bytes(folder / "robot.png", drawn)
        return load_robot(Path(out) / "robot.toml")


def import_robot(path: Path, feet: Sequence[str] = (), sole: Sequence[float] = ()) -> ImportedRobot:
    """Prepare a published robot.

    Args:
        path: an MJCF or a URDF.
        feet: links of the right and the left foot, if the geometry does not tell.
        sole: how far it reaches in front of the ankle and behind it, its width, and how high the ankle is
            over it [m]; if the geometry does not tell.

    Raises:
        InputError: no robot on two legs, or one that cannot stand, with the reason.
    """
    path = Path(path)
    try:
        return _imported(path, tuple(feet), tuple(sole))
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None


def _imported(path: Path, feet: tuple[str, ...], sole: tuple[float, ...]) -> ImportedRobot:
    source = read_published(path)
    assumed, problems = list(source.assumed), list(source.problems)
    skeleton = skeleton_of(source)
    named = None if not feet else (feet[0], feet[1])
    stance = stance_of(skeleton, named, sole)
    if stance.toes:
        assumed.append(f"fixed: toes: {listed(sorted(stance.toes))}")
    skeleton, light = _without_light(fixed(skeleton, stance.toes))
    if light:
        assumed.append(f"fixed: joints that move less than {100 * LIGHT:g} % of the mass: {listed(light)}")
    stance = stance_of(skeleton, named, sole)
    _check_chain(skeleton, stance)
    if stance.turned:
        assumed.append(
            "frames turned to x forward, y left, z up (parameters are given in these): "
            f"{listed(stance.turned)}"
        )
    if sole:
        assumed.append("soles as stated")
    name = path.stem
    # Drives need the length of the legs, which the bare robot tells.
    bare, _ = drives_of(skeleton, 1.0)
    stand = _stand(compose(name, skeleton, stance, bare), skeleton, stance, source.reference)
    drives, more = drives_of(skeleton, stand.leg)
    assumed += more
    spec = compose(name, skeleton, stance, drives)
    add_stand(spec, stand.qpos)
    model = compile_spec(spec.copy(), str(path))
    chain = set(_chain(skeleton, stance))
    free = tuple(hinge.name for hinge in skeleton.hinges if hinge.name not in chain)
    weight = float(model.body_mass.sum()) * 9.81
    table = planning_table(model, stance, stand, free, weight)
    right, left = (skeleton.links[foot.link].name for foot in stance.feet)
    return ImportedRobot(
        name=name,
        source=path,
        found=_found(skeleton, stance, stand, drives, free),
        assumed=tuple(assumed),
        problems=tuple(problems),
        model=spec.to_xml(),
        description=_description(name, path, right, left, table),
    )


def _description(name: str, path: Path, right: str, left: str, table: str) -> str:
    return (
        f"# Prepared by `tulip robot` from {printable(path.name)}; everything here can be edited.\n"
        f"name = {json.dumps(name)}\n"
        'model = "robot.xml"         # the robot alone: links, hinges, motors, sole corners, keyframe stand\n'
        f"stance_foot = {json.dumps(right)}\n"
        f"swing_foot = {json.dumps(left)}\n\n{table}"
    )


def _without_light(skeleton: Skeleton) -> tuple[Skeleton, list[str]]:
    """Fix the joints beyond which there is hardly any mass."""
    light = [
        hinge.name
        for k, link in enumerate(skeleton.links)
        for hinge in link.hinges
        if skeleton.beyond(k) < LIGHT * skeleton.mass
    ]
    return fixed(skeleton, frozenset(light)), light


def _chain(skeleton: Skeleton, stance: Stance) -> list[str]:
    """Return the hinges between the feet."""
    first, second = (set(skeleton.path(foot.link)) for foot in stance.feet)
    return [h.name for k in sorted(first ^ second) for h in skeleton.links[k].hinges]


def _check_chain(skeleton: Skeleton, stance: Stance) -> None:
    """Refuse legs that cannot put a foot where a plan needs it."""
    first, second = (set(skeleton.path(foot.link)) for foot in stance.feet)
    for own, other, foot in ((first, second, stance.feet[0]), (second, first, stance.feet[1])):
        hinges = [h.name for k in sorted(own - other) for h in skeleton.links[k].hinges]
        if len(hinges) < LEAST_CHAIN // 2:
            name = skeleton.links[foot.link].name
            raise InputError(
                f"the leg of foot '{name}' has {len(hinges)} hinges ({listed(hinges)}), expected six or "
                "more: with fewer a foot cannot stand level wherever the other one and the torso are"
            )


def _stand(spec: mujoco.MjSpec, skeleton: Skeleton, stance: Stance, reference: dict[str, float]) -> Standing:
    """Find the posture `stand` of a robot whose links may be anywhere.

    Links that overlap at zero angles, as rough hulls do, count as neighbours.
    """
    right, left = (skeleton.links[foot.link].name for foot in stance.feet)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        write_text(path.with_name("robot.xml"), spec.to_xml())
        write_text(path, _description("robot", path, right, left, ""))
        robot = load_robot(path)
        pairs = link_pairs(robot, NEAR)

    def clearance(angles: np.ndarray) -> float:
        return float(clearances_at(pairs, angles[None], NEAR).distance.min(initial=NEAR))

    return standing(robot, (_middle(stance.feet[0]), _middle(stance.feet[1])), reference, clearance)


def _middle(foot: Foot) -> np.ndarray:
    return foot.corners.mean(axis=0)


def _found(
    skeleton: Skeleton, stance: Stance, stand: Standing, drives: dict[str, Any], free: tuple[str, ...]
) -> dict[str, Any]:
    return {
        "links": len(skeleton.links),
        "joints": len(skeleton.hinges),
        "mass": skeleton.mass,
        "root": skeleton.links[0].name,
        "feet": [skeleton.links[foot.link].name for foot in stance.feet],
        "soles": [np.round(foot.corners, 4).tolist() for foot in stance.feet],
        "leg": stand.leg,
        "height": stand.height,
        "between_feet": _chain(skeleton, stance),
        "others": list(free),
        "torque": {name: drive.torque for name, drive in drives.items()},
        "stand": np.round(stand.qpos, 5).tolist(),
    }
