"""The whole Monte Carlo: check, begin or resume, compute, summarise."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.threads import processes
from tulip_testbed.experiments.imperfections import check_imperfections
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.calibration_report import CalibrationReport, report
from tulip_testbed.experiments.montecarlo.calibration_tables import (
    TOO_FEW,
    calibration_report,
    calibration_table,
)
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.collect import collect
from tulip_testbed.experiments.montecarlo.engine import Work, engine
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of
from tulip_testbed.experiments.montecarlo.montecarlo_folder import (
    CHUNK_FOLDER,
    REPORT_FILE,
    check_folder,
    montecarlo_file,
    open_folder,
    raise_runs,
)
from tulip_testbed.experiments.montecarlo.run_columns import Job, layout_of
from tulip_testbed.experiments.montecarlo.settings import Settings, check_settings
from tulip_testbed.experiments.montecarlo.summary import errors_mm, summarise
from tulip_testbed.experiments.usable_plan import identifiable_regressor
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot_check import warn_of_robot


class Interrupted(KeyboardInterrupt):
    """Stopped by the user; says what stays."""


@dataclass(frozen=True)
class Place:
    """Where the work is done.

    Attributes:
        folder: of the results.
        workers: processes of this machine, if there is no address.
        address: of a Dask scheduler.
        stays: whether the folder outlives the work; otherwise nobody can go on in it.
    """

    folder: Path
    workers: int
    address: str | None
    stays: bool = True


@dataclass(frozen=True, eq=False, repr=False)
class MonteCarlo(Result):
    """Many runs of one experiment, and what they say of the estimator.

    Attributes:
        laboratory, plan, settings: what was repeated.
        report: bias, ratio of standard errors, coverage and checks, as in the run folder's report.json.
        errors_mm: estimate minus truth of every identified run by model, (runs, p) [mm].
        folder: of the runs; gone if it was a temporary one. wall_s: wall time of the last part [s].
    """

    laboratory: Laboratory
    plan: PosturePlan
    settings: Settings
    report: CalibrationReport
    errors_mm: dict[str, np.ndarray]
    folder: Path
    wall_s: float

    @property
    def verdict(self) -> str:
        """ "pass", or "fail" if any check fails; a pass of too few runs is not `conclusive`."""
        return self.report.verdict

    @property
    def conclusive(self) -> bool:
        """Whether the runs settle the verdict: a check failed, or there are enough to show that all hold."""
        return self.report.conclusive

    def table(self) -> Table:
        """Return bias, ratio of standard errors and coverage of the full model's parameters."""
        return calibration_table("full", self.report.plain()["parameters"])

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per parameter of the full model, indexed by name."""
        return self.table().frame().set_index("parameter")

    @property
    def exit_code(self) -> int:
        """Return 0 for a pass, 1 for a failed check."""
        return 0 if self.verdict == "pass" else 1

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document, which `--json` prints: report.json and the wall time."""
        return self.report.plain() | {"wall_s": self.wall_s}

    def tables(self) -> list[Table | str]:
        """Return the parameters, how residuals vary, the checks and the verdict."""
        report = self.report
        enough = {True: ", shown", False: ", inconclusive"}[report.shown] if self.verdict == "pass" else ""
        said = f"Verdict: {self.verdict}{enough}; estimator {report.estimator}, {report.runs} runs"
        few = [TOO_FEW] if self.verdict == "pass" and not report.shown else []
        return [*calibration_report(report.plain()), said, *few]


def montecarlo(
    laboratory: Laboratory,
    plan: PosturePlan,
    settings: Settings,
    place: Place,
    progress: Progress = silent,
) -> MonteCarlo:
    """Carry out what is missing in the folder and report on all runs.

    Args:
        progress: what shows how far the work is, see `collect_missing`.

    Raises:
        InputError: what cannot be run, written or read; runs that were written stay.
        Interrupted: by Ctrl-C, after the folder was begun.
    """
    began = time.perf_counter()
    check_settings(settings)
    if laboratory.sensors == "ideal":
        raise InputError(
            "sensors ideal: found no noise, so no standard errors to judge; valid: wii, force-plate"
        )
    check_imperfections(laboratory, settings.imperfections)
    processes(place.workers)
    laboratory.check(plan, settings.engine)
    warn_of_robot(laboratory.robot)
    identifiable_regressor("plan", laboratory.robot, plan)
    parameters = laboratory.parameters(plan)
    layout = layout_of(laboratory.robot, parameters)
    document = montecarlo_file(laboratory, plan, settings)
    chunks = Chunks(place.folder / CHUNK_FOLDER, settings.runs, settings.chunk)
    raise_runs(place.folder, document)
    if not check_folder(place.folder, document) or chunks.missing():
        with engine(place.workers, place.address):
            job = Job(
                source_of(laboratory, plan, settings.robot_spread, settings.engine, settings.imperfections),
                laboratory.robot,
                parameters,
                layout,
                settings.estimator,
                settings.seed,
                laboratory.known,
            )
            with open_folder(place.folder, document, plan):
                collect_missing(chunks, job, place.folder if place.stays else None, progress)
    found = report(summarise(chunks, layout), layout, settings.estimator, settings.imperfections)
    found.write(place.folder / REPORT_FILE)
    errors, wall = errors_mm(chunks, layout), time.perf_counter() - began
    return MonteCarlo(laboratory, plan, settings, found, errors, place.folder, wall)


def collect_missing(
    chunks: Chunks, job: Work, folder: Path | None, progress: Progress = silent, what: str = "runs"
) -> None:
    """Compute the missing chunks.

    Args:
        folder: what stays; None: nothing does.
        progress: called with what is counted, how many there are and how many were there before; gives a
            context that yields what is called with the number of each chunk's runs.

    Raises:
        InputError: what cannot be computed or written; says what stays.
        Interrupted: by Ctrl-C.
    """
    done = chunks.runs - sum(len(chunks.runs_of(index)) for index in chunks.missing())
    try:
        with progress(what, chunks.runs, done) as advance:
            collect(chunks, job, advance)
    except (InputError, KeyboardInterrupt) as error:
        left = sum(len(chunks.runs_of(index)) for index in chunks.missing())
        stays = f"{folder} holds {chunks.runs - left} of {chunks.runs} {what}; the same command resumes"
        if folder is None:
            stays = "nothing was kept"
        if isinstance(error, KeyboardInterrupt):
            raise Interrupted(f"interrupted; {stays}") from None
        raise InputError(f"{error}; {stays}") from None
