"""A process ends soon after the one that it works for, however that one ended."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from threading import Thread
from typing import Any

INTERVAL = 1.0  # s, between two looks


def end_with(parent: int) -> None:
    """Watch the parent from now on and end after it, together with a process group that is one's own.

    Killed processes cannot end those that they started: these have to look for themselves, from their very
    beginning on.

    Args:
        parent: number of the process that started this one.
    """
    Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(INTERVAL)
    if os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGTERM)
    os._exit(1)


def watched() -> dict[str, Any]:
    """Return what joblib is to be told so that every process that it starts here ends with this one."""
    return {"initializer": end_with, "initargs": (os.getpid(),)}


@contextmanager
def deaf_to_interruptions() -> Iterator[None]:
    """Let processes that are started inside of the block not hear Ctrl-C, which a terminal sends to all.

    It is for this process, which ends them; they would all show a traceback.
    """
    resource_tracker.ensure_running()  # it would let the signal through when it is started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
