"""Read a run folder again: what a page or a view shows is what the run wrote."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, Strict, ValidationError

from tulip_testbed.experiments.montecarlo.calibration_report import report
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.montecarlo_folder import CHUNK_FOLDER, PLAN_FOLDER, RUN_FILE
from tulip_testbed.experiments.montecarlo.run_columns import Layout, layout_of
from tulip_testbed.experiments.montecarlo.settings import CHUNK
from tulip_testbed.experiments.montecarlo.summary import summarise
from tulip_testbed.experiments.usable_plan import planned_parameters
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.sim.errors import InputError, listed, shortened, validation_message
from tulip_testbed.sim.files import present
from tulip_testbed.sim.measurements import Measurements, PosturePlan, read_measurements, read_plan
from tulip_testbed.sim.measurements.folder_kind import KINDS
from tulip_testbed.sim.measurements.table_files import read_json
from tulip_testbed.sim.robot import Robot, sha256

FORMATS = ("tulip-run", "tulip-montecarlo")
RunKind = Literal["run", "montecarlo", "discovery"]
VERSION = 1
Count = Annotated[int, Strict(), Field(ge=1)]


class Head(BaseModel):
    """What every run.json says first."""

    format: str
    version: Annotated[int, Strict()]
    command: str = ""


class Hashed(Head):
    """run.json of a folder that says with what and of what it was made."""

    software: dict[str, str]
    inputs: dict[str, str]
    outputs: dict[str, str]


class Inputs(BaseModel):
    preset: str
    seed: Annotated[int, Strict(), Field(ge=0)]
    robot: str


class RunFile(Hashed):
    """run.json of a validation."""

    configuration: Inputs


class MonteCarloSettings(BaseModel):
    runs: Count
    seed: Annotated[int, Strict(), Field(ge=0)]
    estimator: str
    random_robots: float | None
    dynamics: Annotated[bool, Strict()]
    chunk: Annotated[int, Strict(), Field(ge=1, le=CHUNK)]


class MonteCarloFile(Head):
    """run.json of a Monte Carlo."""

    settings: MonteCarloSettings
    configuration: Inputs
    software: dict[str, str]
    inputs: dict[str, str]


Kind = TypeVar("Kind", bound=Head)


@dataclass(frozen=True)
class SavedRun:
    """A validation as its folder holds it.

    Attributes:
        document: run.json. report: report.json. truth: truth.json.
        residual_mm: norm per row of the measurements, by model, (m,) [mm].
    """

    folder: Path
    document: dict[str, Any]
    report: dict[str, Any]
    truth: dict[str, Any]
    plan: PosturePlan
    measurements: Measurements
    residual_mm: dict[str, np.ndarray]
    robot: Robot


@dataclass(frozen=True)
class SavedMonteCarlo:
    """A Monte Carlo as its folder holds it; the report is that of its runs."""

    folder: Path
    document: dict[str, Any]
    settings: MonteCarloSettings
    report: dict[str, Any]
    plan: PosturePlan
    parameters: BaseParameters
    layout: Layout
    chunks: Chunks
    robot: Robot


def kind_of(folder: Path) -> Literal["run", "montecarlo", "discovery", "plan", "measurement"]:
    """What a folder holds, by the file that describes it.

    Raises:
        InputError: no folder, or none of ours, or one of another version.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    if present(folder / RUN_FILE):
        return _run_kind(folder)
    found = [kind for kind, name in KINDS.items() if present(folder / name)]
    if len(found) != 1:
        expected = listed([RUN_FILE, *KINDS.values()])
        raise InputError(f"{folder}: found {len(found)} of {expected}, expected one of them")
    return "plan" if found[0] == "plan" else "measurement"


def run_kind(folder: Path) -> RunKind:
    """Which command made a run folder.

    Raises:
        InputError: no run folder, or one of another version.
    """
    kind = kind_of(folder)
    if kind != "plan" and kind != "measurement":
        return kind
    raise InputError(f"{folder}: found a {kind} folder, expected a run folder ({RUN_FILE})")


def read_run(folder: Path, robot: Robot) -> SavedRun:
    """Read a validation and check that nothing in it was changed.

    Raises:
        InputError: another kind or version of run, another robot's, or a file that is not what was written.
    """
    folder = Path(folder)
    document = read_json(folder / RUN_FILE)
    outputs = parsed(RunFile, folder, document).outputs
    check_robot(folder, document["inputs"], robot)
    check_outputs(folder, outputs, ("report.json", "truth.json", "residuals.csv"))
    rows = np.genfromtxt(folder / "residuals.csv", delimiter=",", names=True)
    return SavedRun(
        folder,
        document,
        read_json(folder / "report.json"),
        read_json(folder / "truth.json"),
        read_plan(folder / "plan", robot),
        read_measurements(folder / "measurements"),
        {model: np.atleast_1d(rows[f"{model}_mm"]) for model in ("full", "simplified")},
        robot,
    )


def read_montecarlo(folder: Path, robot: Robot) -> SavedMonteCarlo:
    """Read a Monte Carlo; its report is made anew from its runs.

    Raises:
        InputError: another kind or version of run, another robot's, one without its plan, an unfinished one.
    """
    folder = Path(folder)
    document = read_json(folder / RUN_FILE)
    settings = parsed(MonteCarloFile, folder, document).settings
    check_robot(folder, document["inputs"], robot)
    plan = read_plan(folder / PLAN_FOLDER, robot)
    parameters = planned_parameters(robot, plan)
    layout = layout_of(robot, parameters)
    chunks = Chunks(folder / CHUNK_FOLDER, settings.runs, settings.chunk)
    if missing := sum(len(chunks.runs_of(index)) for index in chunks.missing()):
        raise InputError(
            f"{folder}: holds {settings.runs - missing} of {settings.runs} runs; the command that made it "
            "does the rest"
        )
    found = report(summarise(chunks, layout), layout, settings.estimator)
    return SavedMonteCarlo(folder, document, settings, found, plan, parameters, layout, chunks, robot)


def errors_mm(run: SavedMonteCarlo, model: str) -> np.ndarray:
    """Estimate minus truth of every identified run, (runs, p) [mm]."""
    numbers = run.layout.models[model]
    names = [f"{model}.value.{n}" for n in numbers], [f"truth.{n}" for n in numbers]
    parts = []
    for columns in run.chunks.read([*names[0], *names[1], "failure"]):
        value, truth = (np.column_stack([columns[name] for name in of]).astype(float) for of in names)
        parts.append((value - truth)[columns["failure"] == ""])
    return 1e3 * np.vstack(parts)


def _run_kind(folder: Path) -> RunKind:
    where = folder / RUN_FILE
    head = parsed(Head, folder, read_json(where))
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
        return "montecarlo"
    return "discovery" if head.command == "discover" else "run"


def parsed(kind: type[Kind], folder: Path, document: dict[str, Any]) -> Kind:
    """run.json as one of its kinds.

    Raises:
        InputError: it is none.
    """
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise InputError(f"{folder / RUN_FILE}: {validation_message(error)}") from None


def check_outputs(folder: Path, outputs: dict[str, str], needed: tuple[str, ...]) -> None:
    """Refuse a run with a file that is missing or not what was written.

    Raises:
        InputError: names the file.
    """
    for name in needed:
        if name not in outputs:
            raise InputError(f"{folder / RUN_FILE}: key 'outputs': found no {name}")
    for name, expected in outputs.items():
        path = folder / name
        if ".." in Path(name).parts or Path(name).is_absolute():
            raise InputError(f"{folder / RUN_FILE}: key 'outputs': found '{shortened(name)}'")
        if (found := sha256(path)) != expected:
            raise InputError(
                f"{path}: hash mismatch: found sha256 {found[:12]}..., "
                f"expected {shortened(expected[:12])}... by run.json"
            )


def check_robot(folder: Path, inputs: dict[str, str], robot: Robot) -> None:
    """Refuse to draw or judge one robot's run by another robot's files."""
    name = robot.model_file.name
    if inputs.get(name) != robot.model_hash:
        raise InputError(
            f"{folder / RUN_FILE}: key 'inputs': found no {name} with the hash of {robot.model_file}; "
            "--robot names the robot that the run was made with"
        )
