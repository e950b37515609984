"""Compute runs in processes of this machine (loky) or on a Dask cluster, both through joblib."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from typing import Any

import joblib

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.workers import deaf_to_interruptions, watched
from tulip_testbed.experiments.montecarlo.run_chunks import RunChunks

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
        raise InputError(_what_ended(str(error))) from None
    except Exception as error:
        if type(error).__module__.split(".")[0] != "distributed":
            raise
        raise InputError(f"the cluster failed ({' '.join(str(error).split())[:200]})") from None


def _what_ended(text: str) -> str:
    """Say what is known of workers that are gone, by joblib's text."""
    codes = re.search(r"exit codes of the workers are \{(.*?)\}", text)
    if codes is None:
        return f"a worker process failed ({shortened(text, 200)})"
    memory = ", as the system does when memory runs out" if "SIGKILL" in codes[1] else ""
    return f"a worker process ended by {codes[1]}{memory}"


def _carry_out(work: Work, chunk: Sequence[int]) -> Any:
    return work(chunk)
