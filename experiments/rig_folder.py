"""The rig folder: a laboratory with effects that were found, as the new nominal one."""

import difflib
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import mujoco
import numpy as np
from pydantic import ConfigDict, Field

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import is_folder, present
from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Documented
from tulip_testbed.base.table_files import json_text, software
from tulip_testbed.effects.instance import EffectInstance, check_different, check_instance, injected
from tulip_testbed.experiments.run_file import check_files
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements.bounds import Version
from tulip_testbed.sim.plan_folder import check_model
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under, laboratory_scene
from tulip_testbed.sim.specs import compile_spec

RIG_FILE = "rig.json"
RIG = "rig"  # the rig folder within a discovery's
NOMINAL, CHANGED, DIFF = "nominal.xml", "scene.xml", "diff.txt"
FORBIDS = ConfigDict(strict=True, extra="forbid", arbitrary_types_allowed=True)


@dataclass(frozen=True)
class RigRobot:
    """The robot of a rig: file name and hash of its model, hashes of the other files."""

    __pydantic_config__ = FORBIDS

    model: str
    sha256: str
    files: dict[str, str]


@dataclass(frozen=True)
class RigManifest(Documented):
    """rig.json."""

    __pydantic_config__ = FORBIDS

    format: Literal["tulip-rig"]
    version: Version
    robot: RigRobot
    preset: None
    effects: Annotated[tuple[EffectInstance, ...], Field(min_length=1)]
    software: dict[str, str] | None
    files: dict[str, str]


def rig_files(robot: Robot, instances: Sequence[EffectInstance]) -> dict[str, str]:
    """Make the files of a rig folder, as text by name.

    rig.json next to the MJCF of the nominal scene and of the changed one (on plates as they lie under
    straight legs), and the differences in words.

    Args:
        instances: at least one effect.
    """
    nominal = preset_rig("ideal", robot)
    changed = injected(nominal, instances)
    files = {NOMINAL: scene_xml(nominal), CHANGED: scene_xml(changed)}
    files |= {name: scene_xml(rig) for name, (_, rig) in _later(changed).items()}
    files[DIFF] = difference(nominal, changed, instances, files)
    manifest = RigManifest(
        format="tulip-rig",
        version=1,
        robot=RigRobot(robot.model_file.name, robot.model_hash, dict(list(robot.hashes.items())[1:])),
        preset=None,
        effects=tuple(instances),
        software=software(),
        files={name: hashlib.sha256(files[name].encode()).hexdigest() for name in sorted(files)},
    )
    return files | {RIG_FILE: json_text(manifest.to_json())}


def read_rig(folder: Path, robot: Robot) -> tuple[EffectInstance, ...]:
    """Read and check a rig folder, but for its placements: the effects in the order in which they act."""
    folder = Path(folder)
    if not is_folder(folder):
        found = "found a file, expected a" if present(folder) else "no such"
        raise InputError(f"{folder}: {found} rig folder")
    where = folder / RIG_FILE
    if not present(where):
        inside = present(folder / RIG / RIG_FILE)
        hint = f" (there is one in it: {folder / RIG})" if inside else ""
        raise InputError(f"{folder}: found no {RIG_FILE}, expected a rig folder{hint}")
    manifest = RigManifest.read(where)
    check_model(where, manifest.robot.model, manifest.robot.sha256, robot)
    for name in {*(path.name for path in robot.files[1:]), *manifest.robot.files}:
        found, expected = robot.hashes.get(name, "none"), manifest.robot.files.get(name, "none")
        if found != expected:
            raise InputError(
                f"{where}: key 'robot.files': hash mismatch: {robot.folder / name} has sha256 "
                f"{found[:12]}..., expected {shortened(expected[:12])}...; it was changed after the rig was "
                "written"
            )
    if missing := [name for name in (NOMINAL, CHANGED, DIFF) if name not in manifest.files]:
        raise InputError(f"{where}: key 'files': found no {listed(missing)}, expected the hash of each")
    check_files(folder, manifest.files, RIG_FILE, "files")
    for k, effect in enumerate(manifest.effects):
        check_instance(effect, robot, None, f"{where}: key 'effects.{k}'")
    check_different(manifest.effects, f"{where}: key 'effects'")
    if manifest.software == software():  # another version may write the same scene in other words
        for name, text in rig_files(robot, manifest.effects).items():
            if name != RIG_FILE and hashlib.sha256(text.encode()).hexdigest() != manifest.files.get(name):
                raise InputError(f"{folder / name}: found another one than the effects of {RIG_FILE} make")
    return manifest.effects


def _later(rig: Rig) -> dict[str, tuple[float, Rig]]:
    """Laboratories that stand there later, by the name of their scene's file."""
    found: dict[str, tuple[float, Rig]] = {}
    while rig.later is not None:
        found[f"scene-{len(found) + 2}.xml"] = rig.later
        _, rig = rig.later
    return found


def scene_xml(rig: Rig) -> str:
    """MJCF of the laboratory's scene, its plates under straight legs."""
    straight = nominal_robot(rig.robot)
    swing = straight.swing_sole(np.zeros((1, len(straight.parameters.tree.joints))))[:, [0, 1, 5]]
    feet = np.stack([np.zeros_like(swing), swing], axis=1)
    spec: mujoco.MjSpec = laboratory_scene(rig, boards_under(rig, feet)[0])
    compile_spec(spec, str(rig.robot.path))
    return spec.to_xml()


def difference(
    nominal: Rig, changed: Rig, instances: Sequence[EffectInstance], scenes: dict[str, str]
) -> str:
    """Return the changes by the effects in words: findings, instruments, lines of MJCF."""
    lines = ["Effects", *(f"  {found.finding} ({found.effect.sentence})" for found in instances), ""]
    lines += ["Instruments and procedure", *_outside(nominal, changed, instances), "", "Scene (MJCF)"]
    before, *others = [(name, text.splitlines()) for name, text in scenes.items()]
    for name, after in others:
        pieces = difflib.unified_diff(before[1], after, NOMINAL, name, n=1, lineterm="")
        lines += list(pieces) or ["  No line differs."]
    return "\n".join(lines) + "\n"


def _outside(nominal: Rig, changed: Rig, instances: Sequence[EffectInstance]) -> list[str]:
    lines = []
    for found in instances:
        if injected(nominal, [found]).misread is not None:
            both = zip(found.effect.parameters, found.values, strict=True)
            values = ", ".join(f"{one.name} {number(value)} {one.unit}".strip() for one, value in both)
            of = f"{found.target}: " if found.target else ""
            lines.append(f"  Readings are changed: {found.effect.sentence} ({of}{values})")
    for part in ("sensors", "controller", "drives", "compliance", "protocol"):
        for field in fields(getattr(nominal, part)):
            before, after = (getattr(getattr(rig, part), field.name) for rig in (nominal, changed))
            lines += [f"  {part}, {field.name}: {before} -> {after}"] if before != after else []
    lines += [
        f"  From {100 * start:.0f} % of the experiment's time on: {name}"
        for name, (start, _) in _later(changed).items()
    ]
    return lines or ["  Nothing differs."]
