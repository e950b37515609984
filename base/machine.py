"""The machine that computes: its processor, on which the last digits of linear algebra depend."""

import platform
from pathlib import Path

import numpy.linalg  # noqa: F401  threadpoolctl sees the libraries that are loaded by then
from threadpoolctl import threadpool_info

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.files import read_text

CPU_FILE = Path("/proc/cpuinfo")


def machine() -> dict[str, str]:
    """Return the processor's model and the kernels of the libraries for linear algebra."""
    kernels = {
        " ".join(str(one[key]) for key in ("internal_api", "version", "architecture") if one.get(key))
        for one in threadpool_info()
        if one.get("user_api") == "blas"
    }
    return {"cpu": _processor(), "blas": listed(sorted(kernels)) or "unknown"}


def _processor() -> str:
    try:
        lines = read_text(CPU_FILE).splitlines()
    except InputError:  # not Linux
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine() or "unknown"
