"""A worker process ends soon after the process that it works for, however that one ended."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable
from threading import Thread
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
INTERVAL = 1.0  # s, between two looks


def for_parent(parent: int, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a function in a worker, which watches its parent from then on.

    Killed processes cannot end their workers. One of another machine, or the parent itself, watches nothing.

    Args:
        parent: number of the process that the work is for.
    """
    if os.getppid() == parent:
        _watch(parent)
    return function(*args, **kwargs)


@functools.cache
def _watch(parent: int) -> None:
    Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(INTERVAL)
    os._exit(1)
