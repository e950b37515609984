"""The folder of a Monte Carlo: begin or resume it, and compute the runs that it lacks."""

import dataclasses
import re
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from pathlib import Path
from typing import Any

import joblib

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import present
from tulip_testbed.base.progress import Progress
from tulip_testbed.base.resumable import ResumableFolder, alone_on
from tulip_testbed.base.workers import deaf_to_interruptions, watched
from tulip_testbed.experiments.montecarlo.montecarlo_result import (
    CHUNK_FOLDER,
    MonteCarloFile,
)
from tulip_testbed.experiments.montecarlo.run_columns import RunChunks
from tulip_testbed.experiments.run_file import RUN_FILE

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


def run_folder(folder: Path, document: MonteCarloFile) -> ResumableFolder:
    """Return the folder of a Monte Carlo."""
    return ResumableFolder(folder, RUN_FILE, document.plain(), "Monte Carlo", "runs")


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
        run_folder(folder, document.model_copy(update={"settings": before})).begun()
    except InputError:  # `ResumableFolder.begun` says what it is
        return
    if settings.runs >= document.settings.runs:
        return
    with alone_on(folder):
        if left := settings.runs % settings.chunk:
            chunks = RunChunks(folder / CHUNK_FOLDER, settings.runs, settings.chunk)
            chunks.path((settings.runs - left) // settings.chunk).unlink(missing_ok=True)
        there.model_copy(update={"settings": document.settings}).write(folder / RUN_FILE)


def collect_missing(
    chunks: RunChunks, job: Work, workers: int, folder: Path | None, progress: Progress
) -> None:
    """Compute the missing chunks; an interruption says what stays."""
    try:
        with progress("runs", chunks.runs, chunks.done()) as advance:
            collect(chunks, job, advance, workers)
    except (InputError, KeyboardInterrupt) as error:
        stays = "nothing was kept"
        if folder is not None:
            stays = f"{folder} holds {chunks.done()} of {chunks.runs} runs; the same command resumes"
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(f"interrupted; {stays}") from None
        raise InputError(f"{error}; {stays}") from None
