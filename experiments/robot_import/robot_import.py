"""Prepare a published robot: find what the laboratory needs, and write it as a description."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.files import new_folder, write_bytes, write_text
from tulip_testbed.experiments.robot_import.composed_robot import compose, description, planning_table
from tulip_testbed.experiments.robot_import.feet import Stance, stance_of
from tulip_testbed.experiments.robot_import.published import read_published
from tulip_testbed.experiments.robot_import.skeleton import Skeleton, SourceFile, skeleton_of
from tulip_testbed.experiments.robot_import.standing_posture import Standing, standing
from tulip_testbed.identification.link_clearances import clearances_at, unjoined_pairs
from tulip_testbed.sim.robot import DESCRIPTION, Robot, load_robot
from tulip_testbed.sim.specs import compile_spec, xml_of

LIGHT = 0.005  # of the robot's mass: a joint that moves less is fixed
NEAR = 0.1  # m: links farther apart are not looked at
PREPARED = "the prepared robot"
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
        """Write robot.toml, robot.xml and a picture into a new folder, and load the robot.

        Args:
            picture: draws the robot as PNG, or returns None if it cannot.

        Raises:
            InputError: the folder exists or cannot be written, or the laboratory cannot take the robot.
        """
        with new_folder(out) as folder:
            write_text(folder / "robot.xml", self.model)
            write_text(folder / DESCRIPTION, self.description)
            drawn = None if picture is None else picture(load_robot(folder / DESCRIPTION))
            if drawn is not None:
                write_bytes(folder / "robot.png", drawn)
        return load_robot(Path(out) / DESCRIPTION)


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
