"""How many cores are used: one by linear algebra, so that results do not depend on it; and processes."""

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any, ParamSpec, TypeVar

import numpy.linalg  # noqa: F401  threadpoolctl limits the libraries that are loaded by then
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController

from tulip_testbed.base.errors import at_least, at_most

P = ParamSpec("P")
R = TypeVar("R")
MOST_WORKERS = 1000
_lock = Lock()
_inside: list[Any] = []  # one entry for every call under way, of which the last restores


@functools.cache
def _libraries() -> ThreadpoolController:
    """Find the loaded libraries once: reading the memory map takes milliseconds."""
    return ThreadpoolController()


@contextmanager
def _one_blas_thread() -> Iterator[None]:
    with _lock:
        _inside.append(_inside[0] if _inside else _libraries().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            limits = _inside.pop()
            if not _inside:
                limits.restore_original_limits()


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function use one thread for linear algebra.

    The limit holds for the whole process, until the last of such functions has ended: one that ends must not
    lift it for another thread's.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with _one_blas_thread():
            return function(*args, **kwargs)

    return limited


def processes(workers: int | None) -> int:
    """Return how many processes to use, one per core if nothing else is asked for."""
    if workers is None:
        return os.cpu_count() or 1
    at_least("workers", workers, 1)
    at_most("workers", workers, MOST_WORKERS)
    return workers
