"""The record of a validation and its folder: run.json, report.json, truth.json, plan, measurements."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator

from tulip_testbed.base.document import Document, Figure, Pair
from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import new_folder, read_bytes
from tulip_testbed.base.table_files import Table
from tulip_testbed.experiments.estimate_report import ModelReport
from tulip_testbed.experiments.run_file import (
    MEASUREMENT_FOLDER,
    PLAN_FOLDER,
    RUN_FILE,
    Configuration,
    RunFile,
    check_outputs,
    check_parameters,
    check_robot,
    check_rows,
    write_run_file,
)
from tulip_testbed.experiments.truth_record import Truth
from tulip_testbed.identification.base_parameters import base_parameters, common_support, simplified_numbers
from tulip_testbed.measurements import Measurements, PosturePlan, read_measurements, write_measurements
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.robot import Robot

MODELS = ("full", "simplified")
REPORT_FILE, TRUTH_FILE, RESIDUAL_FILE = "report.json", "truth.json", "residuals.csv"


class CheckRow(Document):
    """A line of the verdict; threshold: an upper limit, or [low, high]."""

    name: str
    result: Literal["pass", "fail", "not evaluated"]
    value: Figure
    threshold: float | Pair | None
    source: str


def _each_once(checks: list[CheckRow]) -> list[CheckRow]:
    if len({check.name for check in checks}) < len(checks):
        raise ValueError("expected each check once")
    return checks


class Dropped(Document):
    """A posture that could not be measured."""

    posture: int
    reason: str


class TotalMass(Document):
    """The robot's mass [kg]."""

    truth: float
    estimate: float
    standard_error: float


class LeastSquares(Document):
    """The paper's estimates from the same measurements."""

    full: ModelReport
    simplified: ModelReport


class Report(Document):
    """report.json; books: the largest imbalance of any hold, null in statics.

    least_squares: null where it cannot be used, see `Validation`.
    imperfections: scale of those that were drawn for the laboratory; 0: it is exact.
    """

    verdict: Literal["pass", "fail"]
    estimator: str
    checks: Annotated[list[CheckRow], AfterValidator(_each_once)]
    postures_planned: int
    postures_used: int
    rows_measured: int
    dropped: list[Dropped]
    condition_number: float
    total_mass: TotalMass
    full: ModelReport
    simplified: ModelReport
    least_squares: LeastSquares | None
    books: dict[str, float] | None
    wall_s: float
    imperfections: float

    @property
    def models(self) -> dict[str, ModelReport]:
        """The estimates by model."""
        return {"full": self.full, "simplified": self.simplified}


@dataclass(frozen=True)
class ValidationRecord:
    """A validation as its folder holds it.

    Attributes:
        document: run.json. report: report.json. truth: truth.json.
        residual_mm: norm per row of the measurements, by model, (m,) [mm].
        folder: None: in memory alone.
    """

    kind: ClassVar[str] = "validation"
    document: RunFile[Configuration]
    report: Report
    truth: Truth
    plan: PosturePlan
    measurements: Measurements
    residual_mm: dict[str, np.ndarray]
    robot: Robot
    folder: Path | None = None


def write_validation(folder: Path, record: ValidationRecord) -> ValidationRecord:
    """Write a validation; the folder appears whole or not at all.

    Returns:
        the record as it is in the folder.

    Raises:
        InputError: the folder exists or cannot be written.
    """
    with new_folder(folder) as working:
        write_plan(working / PLAN_FOLDER, record.plan)
        write_measurements(working / MEASUREMENT_FOLDER, record.measurements)
        record.report.write(working / REPORT_FILE)
        record.truth.write(working / TRUTH_FILE)
        _write_csv(working / "parameters.csv", _parameter_rows(record.report))
        _write_csv(working / RESIDUAL_FILE, _residual_rows(record))
        document = write_run_file(working, record.document)
    return replace(record, document=document, folder=Path(folder))


def read_validation(folder: Path, robot: Robot) -> ValidationRecord:
    """Read a validation and check that its files are what was written and fit each other.

    Raises:
        InputError: another kind or version of run, another robot's, or a file that is not what was written.
    """
    folder = Path(folder)
    document = RunFile[Configuration].read(folder / RUN_FILE)
    check_robot(folder, document.inputs, robot)
    check_outputs(folder, document.outputs, (REPORT_FILE, TRUTH_FILE, RESIDUAL_FILE))
    record = ValidationRecord(
        document=document,
        report=Report.read(folder / REPORT_FILE),
        truth=Truth.read(folder / TRUTH_FILE),
        plan=read_plan(folder / PLAN_FOLDER, robot),
        measurements=read_measurements(folder / MEASUREMENT_FOLDER),
        residual_mm=_read_residuals(folder / RESIDUAL_FILE),
        robot=robot,
        folder=folder,
    )
    _check_fit(folder, record)
    return record


def _read_residuals(path: Path) -> dict[str, np.ndarray]:
    table = Table(path, read_bytes(path))
    return {model: table.numbers(f"{model}_mm") for model in MODELS}


def _check_fit(folder: Path, record: ValidationRecord) -> None:
    """Refuse documents that speak of another robot's parameters or of other postures."""
    measured, robot, truth = record.measurements, record.robot, record.truth
    parameters = base_parameters(robot, support=common_support(measured.support))
    kept = {"full": range(1, len(parameters.names) + 1), "simplified": simplified_numbers(robot, parameters)}
    for model, numbers in kept.items():
        check_parameters(
            folder / REPORT_FILE,
            f"{model}.parameters",
            [(row.number, row.name) for row in record.report.models[model].parameters],
            [(number, parameters.names[number - 1]) for number in numbers],
        )
        for k, row in enumerate(record.report.models[model].parameters):
            if row.truth is None:
                where = f"{folder / REPORT_FILE}: key '{model}.parameters.{k}.truth'"
                raise InputError(f"{where}: found None, expected a number")
    if truth.links != list(parameters.tree.links) or len(truth.standard_parameters) != len(truth.links):
        raise InputError(
            f"{folder / TRUTH_FILE}: key 'links': found {len(truth.standard_parameters)} rows of standard "
            f"parameters of {shortened(truth.links)}, expected one for each of the robot's "
            f"{len(parameters.tree.links)} links"
        )
    if truth.attempts and [attempt.posture for attempt in truth.held] != measured.posture.tolist():
        raise InputError(f"{folder / TRUTH_FILE}: found other postures than in the measurements")
    check_rows(folder / RESIDUAL_FILE, len(record.residual_mm["full"]), measured)


def _parameter_rows(report: Report) -> Iterator[dict[str, Any]]:
    for model, estimate in report.models.items():
        for row in estimate.parameters:
            yield {"model": model} | row.model_dump()


def _residual_rows(record: ValidationRecord) -> Iterator[dict[str, Any]]:
    measured = record.measurements
    for k in range(len(measured)):
        yield {
            "posture": int(measured.posture[k]),
            "placement": int(measured.placement[k]),
            "full_mm": float(record.residual_mm["full"][k]),
            "simplified_mm": float(record.residual_mm["simplified"][k]),
        }


def _write_csv(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    rows = list(rows)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
