"""run.json: how a run was made, with which versions, from which files, and the hashes of what it wrote."""

import dataclasses
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import is_folder, present, sha256
from tulip_testbed.base.machine import machine
from tulip_testbed.base.result import RESULT_FILE, Documented, Kept, Result
from tulip_testbed.base.table_files import finite, software
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.folder_kind import KINDS
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.shipped import TULIP

RUN_FILE, PLAN_FOLDER, MEASUREMENT_FOLDER = "run.json", "plan", "measurements"
FORMATS = ("tulip-run", "tulip-montecarlo")
VERSION = 2
RunKind = Literal["validation", "discovery", "Monte Carlo"]


def _write_robot(folder: Path, robot: Robot) -> None:
    """Copy the files of a robot of one's own into a run folder; TULip's are everywhere."""
    names = (*robot.hashes, *filter(None, [robot.settings.get("paper", {}).get("table")]))
    for name in names if robot.path != TULIP else ():
        source, place = (robot.folder / name).resolve(), (folder / name).resolve()
        if source.is_file() and place.is_relative_to(folder.resolve()):
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, place)


ROBOT = Kept("robot", _write_robot, lambda folder, robot: robot)


def robot_of(folder: Path) -> Path:
    """Return the description of the robot that a run was made with: its own, or else TULip's."""
    try:
        return next(iter(sorted((folder / ROBOT.name).glob("*.toml"))), TULIP)
    except OSError:  # what reads the run says why
        return TULIP


@dataclass(frozen=True, kw_only=True)
class Head(Documented):
    """The first entries of every run.json."""

    format: str
    version: int
    command: str = ""


@dataclass(frozen=True, kw_only=True)
class RunFile(Head):
    """run.json of a folder whose files are listed with their hashes; a run in memory has no outputs.

    Attributes:
        configuration: everything that was set. software: versions.
        machine: processor and kernel of linear algebra; older runs do not tell.
        inputs, outputs: hashes of the files that were read and written.
    """

    configuration: dict[str, Any]
    software: dict[str, str]
    machine: dict[str, str] = field(default_factory=dict)
    inputs: dict[str, str]
    outputs: dict[str, str] = field(default_factory=dict)


def configuration_of(
    laboratory: Laboratory, plan: PosturePlan, seed: int, engine: str, imperfections: float = 0.0
) -> dict[str, Any]:
    """List everything that was set, for run folders and truth files.

    Args:
        seed, engine: see `Laboratory.run`.
        imperfections: scale of those that were drawn for the laboratory; 0: it is exact.
    """
    rig = laboratory.rig
    parts = ("controller", "drives", "compliance", "sensors", "protocol")
    content: dict[str, Any] = {
        "preset": laboratory.sensors,
        "seed": seed,
        "robot": rig.robot.path.name,
        **{part: dataclasses.asdict(getattr(rig, part)) for part in parts},
        "edited": rig.edit is not None,
        "adopted": [found.document() for found in laboratory.known],
        "statics": engine == "statics",
        "plan": {"robot": plan.robot, "made": plan.made, "postures": len(plan)},
    }
    if rig.sensors.wrench is None:
        del content["sensors"]["wrench"]
    if imperfections:
        content["imperfections"] = float(imperfections)
    if laboratory.random_robot is not None:
        content["random_robot"] = dict(zip(("spread", "seed"), laboratory.random_robot, strict=True))
    return finite(content)  # with lists for tuples, as it will be read again


def made_by(command: str, configuration: dict[str, Any], robot: Robot) -> RunFile:
    """Describe how a run was made here and now."""
    return RunFile(
        format="tulip-run",
        version=VERSION,
        command=command,
        configuration=configuration,
        software=software(),
        machine=machine(),
        inputs=robot.hashes,
    )


def write_run_file(path: Path, made: RunFile) -> None:
    """Write run.json with the hashes of all other files of its folder."""
    files = sorted(file for file in path.parent.rglob("*") if file.is_file())
    outputs = {str(file.relative_to(path.parent)): sha256(file) for file in files}
    dataclasses.replace(made, outputs=outputs).write(path)


MADE = Kept(RUN_FILE, write_run_file, lambda path, robot: RunFile.read(path))


class SavedRun(Result):
    """A result whose folder lists all of its files with their hashes in run.json."""

    kind: ClassVar[RunKind]

    @classmethod
    def load(cls, folder: str | Path, *context: Any) -> Self:
        """Read a run folder and check that its files are what was written and fit each other.

        Args:
            context: the robot that the run was made with.

        Raises:
            InputError: another kind or version of run, another robot's, or a file that is not what was
                written.
        """
        folder = Path(folder)
        if (kind := run_kind(folder)) != cls.kind:
            raise InputError(f"{folder}: found the run folder of a {kind}, expected that of a {cls.kind}")
        made = RunFile.read(folder / RUN_FILE)
        check_robot(folder, made.inputs, *context)
        if RESULT_FILE not in made.outputs:
            raise InputError(f"{folder / RUN_FILE}: key 'outputs': found no {RESULT_FILE}")
        check_files(folder, made.outputs, RUN_FILE)
        return super().load(folder, *context)


def check_files(folder: Path, outputs: dict[str, str], by: str, key: str = "outputs") -> None:
    """Refuse files that are missing or have another sha256 than an entry (`key`) of a file (`by`) states."""
    for name, expected in outputs.items():
        path = folder / name
        if ".." in Path(name).parts or Path(name).is_absolute():
            raise InputError(f"{folder / by}: key '{key}': found '{shortened(name)}'")
        if (found := sha256(path)) != expected:
            raise InputError(
                f"{path}: hash mismatch: found sha256 {found[:12]}..., "
                f"expected {shortened(expected[:12])}... by {by}"
            )


def check_robot(folder: Path, inputs: dict[str, str], robot: Robot) -> None:
    """Refuse to draw or judge one robot's run by another robot's files."""
    name = robot.model_file.name
    _, *files = robot.hashes.items()
    if name not in inputs or any(inputs.get(file, found) != found for file, found in files):
        raise InputError(
            f"{folder / RUN_FILE}: key 'inputs': found no {name} with the hash of {robot.model_file}; "
            "give the robot that the run was made with"
        )


def kind_of(folder: Path) -> RunKind | Literal["plan", "measurement"]:
    """Return what a folder holds, by the file that describes it."""
    folder = Path(folder)
    if not is_folder(folder):
        found = "found a file, expected a folder" if present(folder) else "no such folder"
        raise InputError(f"{folder}: {found}")
    where = folder / RUN_FILE
    if present(where):
        head = Head.read(where)
        if head.format not in FORMATS:
            raise InputError(
                f"{where}: key 'format': found '{shortened(head.format)}', expected one of {listed(FORMATS)}"
            )
        if head.version != VERSION:
            raise InputError(
                f"{where}: key 'version': found {head.version}, expected {VERSION}: another version of this "
                "program made the run"
            )
        if head.format == "tulip-montecarlo":
            return "Monte Carlo"
        return "discovery" if head.command == "discover" else "validation"
    found = [kind for kind, name in KINDS.items() if present(folder / name)]
    if len(found) != 1:
        expected = listed(dict.fromkeys([RUN_FILE, *KINDS.values()]))
        raise InputError(f"{folder}: found {len(found)} of {expected}, expected one of them")
    return "plan" if found[0] == "plan" else "measurement"


def run_kind(folder: Path) -> RunKind:
    if (kind := kind_of(folder)) in ("plan", "measurement"):
        raise InputError(f"{folder}: found a {kind} folder, expected a run folder ({RUN_FILE})")
    return kind
