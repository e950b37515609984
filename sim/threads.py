"""Limit linear algebra to one thread, so that results do not depend on the number of cores."""

from __future__ import annotations

import numpy.linalg  # noqa: F401  threadpoolctl limits the libraries that are loaded by then
import scipy.linalg  # noqa: F401
from threadpoolctl import threadpool_limits

one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
