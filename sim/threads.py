"""How many cores are used: one by linear algebra, so that results do not depend on it; and processes."""

from __future__ import annotations

import os

import numpy.linalg  # noqa: F401  threadpoolctl limits the libraries that are loaded by then
import scipy.linalg  # noqa: F401
from threadpoolctl import threadpool_limits

from tulip_testbed.sim.errors import at_least

one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")


def processes(workers: int | None) -> int:
    """Return how many processes to use, one a core if nothing else is asked for.

    Raises:
        InputError: fewer than one.
    """
    if workers is None:
        return os.cpu_count() or 1
    at_least("workers", workers, 1)
    return workers
