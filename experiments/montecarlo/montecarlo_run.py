"""The whole Monte Carlo: check, begin or resume, compute, summarise."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import present
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.resumable import ResumableFolder, alone_on
from tulip_testbed.base.table_files import write_json
from tulip_testbed.base.threads import processes
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
from tulip_testbed.experiments.montecarlo.run_columns import RunChunks, RunJob, layout_of, read_runs
from tulip_testbed.experiments.run_file import RUN_FILE
from tulip_testbed.experiments.usable_plan import identifiable_regressor
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot_check import warn_of_robot

PATIENCE = 10  # s, for a scheduler that does not answer and for its first worker

Work = Callable[[Sequence[int]], Any]


@contextmanager
def computed_by(workers: int, address: str | None) -> Iterator[None]:
    """Send everything that `collect` is given inside of the block to these processes.

    Args:
        workers: processes of this machine, if there is no address.
        address: of a Dask scheduler.
    """
    with ExitStack() as stack:
        if address is None:
            mine = {"n_jobs": workers, "inner_max_num_threads": 1, **watched()}
            stack.enter_context(joblib.parallel_config("loky", **mine))
        else:
            client = stack.enter_context(_client(address))
            stack.enter_context(joblib.parallel_config("dask", client=client))
        yield


def collect(chunks: RunChunks, work: Work, advance: Callable[[int], None]) -> None:
    """Compute every missing chunk and write each as soon as it is there.

    Args:
        work: from run numbers to their columns.
        advance: called with the number of runs of each chunk that was written.
    """
    results = _compute(work, (chunks.runs_of(index) for index in chunks.missing()))
    try:
        for columns in results:
            advance(chunks.write(columns))
    finally:
        results.close()


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise InputError(
            "scheduler: Dask is not installed; install the extra: pip install 'tulip-testbed[cluster]'"
        ) from None
    if not re.fullmatch(r"(tcp|tls|ws|wss|ucx)://.+:\d+", address):
        raise InputError(
            f"scheduler: found '{address}', expected the scheduler's, such as tcp://10.0.0.5:8786"
        )
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        what = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"scheduler {address}: no Dask scheduler within {PATIENCE} s ({what})") from None
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        client.close()
        raise InputError(
            f"scheduler {address}: the scheduler has no worker (waited {PATIENCE} s); "
            f"start one: dask worker {address}"
        ) from None
    return client


def _compute(work: Work, chunks: Iterable[Sequence[int]]) -> Generator[Any]:
    """Yield the work's results in the order in which they come."""
    parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1)
    try:
        # As an argument the work is sent to a cluster once, and need not be hashable: joblib's Dask backend
        # hashes functions, and waits forever where that fails.
        with deaf_to_interruptions():
            results = parallel(joblib.delayed(_carry_out)(work, chunk) for chunk in chunks)
        yield from results
    except BrokenProcessPool as error:
        codes = re.search(r"exit codes of the workers are \{(.*?)\}", str(error))
        if codes is None:
            raise InputError(f"a worker process failed ({shortened(error, 200)})") from None
        memory = ", as the system does when memory runs out" if "SIGKILL" in codes[1] else ""
        raise InputError(f"a worker process ended by {codes[1]}{memory}") from None
    except Exception as error:
        if type(error).__module__.split(".")[0] != "distributed":
            raise
        raise InputError(f"the cluster failed ({' '.join(str(error).split())[:200]})") from None


def _carry_out(work: Work, chunk: Sequence[int]) -> Any:
    return work(chunk)


@dataclass(frozen=True)
class RunPlace:
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


def montecarlo(
    laboratory: Laboratory,
    plan: PosturePlan,
    settings: Settings,
    place: RunPlace,
    progress: Progress = silent,
) -> MonteCarlo:
    """Carry out what is missing in the folder and report on all runs.

    Args:
        progress: called with what is counted, how many there are and how many were there before; gives a
            context that yields what is called with the number of each chunk's runs.

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
    processes(place.workers)
    laboratory.check(plan, settings.engine)
    warn_of_robot(laboratory.robot)
    identifiable_regressor("plan", laboratory.robot, plan)
    robot, parameters = laboratory.robot, laboratory.parameters(plan)
    layout = layout_of(robot, parameters)
    document = montecarlo_file(laboratory, plan, settings)
    chunks = RunChunks(place.folder / CHUNK_FOLDER, settings.runs, settings.chunk)
    raise_runs(place.folder, document)
    kept = run_folder(place.folder, document)
    if not kept.begun() or chunks.missing():
        with computed_by(place.workers, place.address):
            job = RunJob(
                source_of(laboratory, plan, settings.robot_spread, settings.engine, settings.imperfections),
                robot,
                parameters,
                layout,
                settings.estimator,
                settings.seed,
                laboratory.known,
            )
            with kept.opened(partial(begin, plan=plan, robot=robot)):
                _collect_missing(chunks, job, place, progress)
    folder = place.folder if place.stays else None
    result = MonteCarlo.of(read_runs(chunks, layout), layout, document, plan=plan, robot=robot, folder=folder)
    write_json(place.folder / REPORT_FILE, result.to_json())
    return result


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


def _collect_missing(chunks: RunChunks, job: Work, place: RunPlace, progress: Progress) -> None:
    """Compute the missing chunks; an interruption says what stays."""
    try:
        with progress("runs", chunks.runs, chunks.done()) as advance:
            collect(chunks, job, advance)
    except (InputError, KeyboardInterrupt) as error:
        stays = "nothing was kept"
        if place.stays:
            stays = f"{place.folder} holds {chunks.done()} of {chunks.runs} runs; the same command resumes"
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(f"interrupted; {stays}") from None
        raise InputError(f"{error}; {stays}") from None
