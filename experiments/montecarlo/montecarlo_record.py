"""The record of a Monte Carlo, from its folder or from memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.montecarlo.calibration_report import CalibrationReport, report
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.montecarlo_folder import (
    CHUNK_FOLDER,
    RunsFile,
    check_plan,
    montecarlo_file,
)
from tulip_testbed.experiments.montecarlo.montecarlo_run import MonteCarlo
from tulip_testbed.experiments.montecarlo.run_columns import layout_of
from tulip_testbed.experiments.montecarlo.settings import MonteCarloSettings
from tulip_testbed.experiments.montecarlo.summary import errors_mm, summarise
from tulip_testbed.experiments.run_file import PLAN_FOLDER, RUN_FILE, check_robot
from tulip_testbed.experiments.usable_plan import planned_parameters
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import Robot


@dataclass(frozen=True)
class MonteCarloRecord:
    """A Monte Carlo as its folder holds it.

    Attributes:
        document: run.json. report: report.json.
        errors_mm: estimate minus truth of every identified run by model, (runs, p) [mm].
        folder: None: in memory alone.
    """

    kind: ClassVar[str] = "Monte Carlo"
    document: RunsFile[MonteCarloSettings]
    report: CalibrationReport
    plan: PosturePlan
    errors_mm: dict[str, np.ndarray]
    robot: Robot
    folder: Path | None = None


def montecarlo_record(result: MonteCarlo) -> MonteCarloRecord:
    """Make the record of a Monte Carlo that has just been carried out."""
    return MonteCarloRecord(
        document=montecarlo_file(result.laboratory, result.plan, result.settings),
        report=result.report,
        plan=result.plan,
        errors_mm=result.errors_mm,
        robot=result.laboratory.robot,
    )


def read_montecarlo(folder: Path, robot: Robot) -> MonteCarloRecord:
    """Read a Monte Carlo; its report is made again from its runs.

    Raises:
        InputError: another kind or version of run, another robot's, one without its plan, an unfinished one.
    """
    folder = Path(folder)
    document = RunsFile[MonteCarloSettings].read(folder / RUN_FILE)
    settings = document.settings
    check_robot(folder, document.inputs, robot)
    plan = read_plan(folder / PLAN_FOLDER, robot)
    check_plan(folder, document.inputs, plan)
    layout = layout_of(robot, planned_parameters(robot, plan))
    chunks = Chunks(folder / CHUNK_FOLDER, settings.runs, settings.chunk)
    if missing := sum(len(chunks.runs_of(index)) for index in chunks.missing()):
        raise InputError(
            f"{folder}: holds {settings.runs - missing} of {settings.runs} runs; the command that made it "
            "does the rest"
        )
    found = report(summarise(chunks, layout), layout, settings.estimator, settings.imperfections)
    return MonteCarloRecord(document, found, plan, errors_mm(chunks, layout), robot, folder)
