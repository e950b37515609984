"""The whole Monte Carlo: check, begin or resume, compute, summarise."""

import dataclasses
import re
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import joblib

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import present
from tulip_testbed.base.progress import Progress
from tulip_testbed.base.resumable import ResumableFolder, alone_on
from tulip_testbed.base.table_files import write_json
from tulip_testbed.base.workers import deaf_to_interruptions, watched
from tulip_testbed.experiments.imperfections import check_imperfections
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of
from tulip_testbed.experiments.montecarlo.montecarlo_result import (
    CHUNK_FOLDER,
    REPORT_FILE,
    MonteCarlo,
    MonteCarloFile,
    Settings,
    begin,
    montecarlo_file,
)
from tulip_testbed.experiments.montecarlo.run_columns import RunChunks, layout_of, read_runs, run_job
from tulip_testbed.experiments.run_file import RUN_FILE
from tulip_testbed.experiments.usable_plan import identifiable_regressor
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot_check import warn_of_robot

Work = Callable[[Sequence[int]], Any]  # from run numbers to their columns


def collect(chunks: RunChunks, work: Work, advance: Callable[[int], None], workers: int) -> None:
    """Compute every missing chunk and write each as soon as it is there; advance: by so many runs."""
    limits = {"n_jobs": workers, "inner_max_num_threads": 1, **watched()}
    try:
        with joblib.parallel_config("loky", **limits), deaf_to_interruptions():
            parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1)
            results = parallel(joblib.delayed(work)(chunks.runs_of(index)) for index in chunks.missing())
        with closing(results):
            for columns in results:
                advance(chunks.write(columns))
    except BrokenProcessPool as error:
        codes = re.search(r"exit codes of the workers are \{(.*?)\}", str(error))
        if codes is None:
            raise InputError(f"a worker process failed ({shortened(error, 200)})") from None
        memory = ", as the system does when memory runs out" if "SIGKILL" in codes[1] else ""
        raise InputError(f"a worker process ended by {codes[1]}{memory}") from None


def montecarlo(
    laboratory: Laboratory,
    plan: PosturePlan,
    settings: Settings,
    folder: Path,
    workers: int,
    stays: bool,
    progress: Progress,
) -> MonteCarlo:
    """Carry out what is missing in the folder and report on all runs; see `tulip_testbed.monte_carlo`.

    Args:
        stays: whether the folder outlives the work; otherwise nobody can go on in it.

    Raises:
        InputError: what cannot be run, written or read; runs that were written stay.
        KeyboardInterrupt: by Ctrl-C; after the folder was begun it says what stays.
    """
    settings.check()
    if laboratory.sensors == "ideal":
        raise InputError(
            "sensors ideal: found no noise, so no standard errors to judge; valid: wii, force-plate"
        )
    check_imperfections(laboratory, settings.imperfections)
    laboratory.check(plan, settings.engine)
    warn_of_robot(laboratory.robot)
    identifiable_regressor("plan", laboratory.robot, plan)
    robot, parameters = laboratory.robot, laboratory.parameters(plan)
    layout = layout_of(robot, parameters)
    document = montecarlo_file(laboratory, plan, settings)
    chunks = RunChunks(folder / CHUNK_FOLDER, settings.runs, settings.chunk)
    raise_runs(folder, document)
    kept, kept_in = run_folder(folder, document), folder if stays else None
    if not kept.begun() or chunks.missing():
        more = (settings.robot_spread, settings.engine, settings.imperfections)
        source = source_of(laboratory, plan, *more)
        job = run_job(source, laboratory, parameters, settings.estimator, settings.seed)
        with kept.opened(partial(begin, plan=plan, robot=robot)):
            try:
                with progress("runs", chunks.runs, chunks.done()) as advance:
                    collect(chunks, job, advance, workers)
            except (InputError, KeyboardInterrupt) as error:
                stay = f"{kept_in} holds {chunks.done()} of {chunks.runs} runs; the same command resumes"
                stay = stay if stays else "nothing was kept"
                if isinstance(error, KeyboardInterrupt):
                    raise KeyboardInterrupt(f"interrupted; {stay}") from None
                raise InputError(f"{error}; {stay}") from None
    beside = {"plan": plan, "robot": robot, "folder": kept_in}
    result = MonteCarlo.of(read_runs(chunks, layout), layout, document, **beside)
    write_json(folder / REPORT_FILE, result.to_json())
    return result


def run_folder(folder: Path, document: MonteCarloFile) -> ResumableFolder:
    return ResumableFolder(folder, RUN_FILE, document.to_json(), "Monte Carlo", "runs")


def raise_runs(folder: Path, document: MonteCarloFile) -> None:
    """Ask for more runs in a folder that holds fewer of the same kind; leave every other folder alone.

    A run depends on its number and the seed alone, so those that are there stay. A last file that was not
    full is made again.
    """
    if not present(folder / RUN_FILE):
        return
    try:
        there = MonteCarloFile.read(folder / RUN_FILE)
        settings = there.settings
        before = dataclasses.replace(document.settings, runs=settings.runs)
        run_folder(folder, dataclasses.replace(document, settings=before)).begun()
    except InputError:  # `ResumableFolder.begun` says what it is
        return
    if settings.runs >= document.settings.runs:
        return
    with alone_on(folder):
        if left := settings.runs % settings.chunk:
            chunks = RunChunks(folder / CHUNK_FOLDER, settings.runs, settings.chunk)
            chunks.path((settings.runs - left) // settings.chunk).unlink(missing_ok=True)
        dataclasses.replace(there, settings=document.settings).write(folder / RUN_FILE)
