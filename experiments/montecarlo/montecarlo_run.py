"""The whole Monte Carlo: check, begin or resume, compute, summarise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tulip_testbed.experiments.montecarlo.calibration_report import report
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.collect import collect
from tulip_testbed.experiments.montecarlo.engine import Work, engine
from tulip_testbed.experiments.montecarlo.laboratory_runs import laboratory
from tulip_testbed.experiments.montecarlo.montecarlo_folder import (
    CHUNK_FOLDER,
    REPORT_FILE,
    check_folder,
    open_folder,
    run_document,
)
from tulip_testbed.experiments.montecarlo.run_columns import Job, layout_of
from tulip_testbed.experiments.montecarlo.settings import Settings
from tulip_testbed.experiments.montecarlo.summary import summarise
from tulip_testbed.experiments.preparation import true_parameters
from tulip_testbed.experiments.scenario import Scenario
from tulip_testbed.experiments.terminal import progress
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements.table_files import write_json


class Interrupted(KeyboardInterrupt):
    """Stopped by the user; says what stays."""


@dataclass(frozen=True)
class Place:
    """Where the work is done.

    Attributes:
        folder: of the results.
        workers: processes of this machine, if there is no address.
        address: of a Dask scheduler.
    """

    folder: Path
    workers: int
    address: str | None


def montecarlo(scenario: Scenario, settings: Settings, place: Place) -> dict[str, Any]:
    """Carry out what is missing in the folder and report on all runs.

    Returns:
        the report, which is also in the folder.

    Raises:
        InputError: what cannot be run, written or read; runs that were written stay.
        Interrupted: by Ctrl-C, after the folder was begun.
    """
    parameters = true_parameters(scenario)
    layout = layout_of(scenario.rig.robot, parameters)
    document = run_document(scenario, settings.document())
    chunks = Chunks(place.folder / CHUNK_FOLDER, settings.runs, settings.chunk)
    if not check_folder(place.folder, document) or chunks.missing():
        with engine(place.workers, place.address):
            job = Job(
                laboratory(scenario, settings.spread, settings.dynamics),
                scenario.rig.robot,
                parameters,
                layout,
                settings.estimator,
                settings.seed,
                scenario.adopted,
            )
            with open_folder(place.folder, document, scenario.plan):
                collect_missing(chunks, job, place.folder)
    found = report(summarise(chunks, layout), layout, settings.estimator)
    write_json(place.folder / REPORT_FILE, found)
    return found


def collect_missing(chunks: Chunks, job: Work, folder: Path, what: str = "runs") -> None:
    """Compute the missing chunks with a progress bar.

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
        if isinstance(error, KeyboardInterrupt):
            raise Interrupted(f"interrupted; {stays}") from None
        raise InputError(f"{error}; {stays}") from None
