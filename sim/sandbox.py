"""Compile an MJCF in a separate process first, so that a crash or an endless loop of MuJoCo is harmless."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
from pathlib import Path

from tulip_testbed.sim.errors import InputError, shortened

MOST_SECONDS = 20  # of processor time
MOST_MEMORY = 4 * 2**30  # bytes
MOST_WAIT = 300  # seconds, for busy machines

CHILD = f"""
import resource, sys
import mujoco
resource.setrlimit(resource.RLIMIT_DATA, ({MOST_MEMORY}, {MOST_MEMORY}))
resource.setrlimit(resource.RLIMIT_CPU, ({MOST_SECONDS}, {MOST_SECONDS + 5}))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
mujoco.set_mju_user_warning(lambda message: None)
try:
    mujoco.MjSpec.from_file(sys.argv[1]).compile()
except Exception as error:
    sys.exit(str(error))
"""


def try_to_compile(path: Path, hashes: dict[Path, str]) -> None:
    """Compile an MJCF in a separate process, once as long as no file changes.

    Args:
        hashes: hashes of all files of the MJCF.

    Raises:
        InputError: MuJoCo refuses the MJCF, crashes, or needs too much time or memory.
    """
    _try(path, frozenset(hashes.items()))


@functools.lru_cache(maxsize=64)
def _try(path: Path, hashes: frozenset[tuple[Path, str]]) -> None:
    command = [sys.executable, "-c", CHILD, str(path)]
    # More threads would only take address space.
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MUJOCO_GL": "disable"}
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            env=environment,
            timeout=MOST_WAIT,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: broken MJCF: MuJoCo did not compile it within {MOST_WAIT} s") from None
    message = shortened(done.stderr.decode("utf-8", "replace"), 300)
    if done.returncode == -signal.SIGXCPU:
        message = f"MuJoCo did not compile it within {MOST_SECONDS} s of processor time"
    elif done.returncode < 0:
        message = f"MuJoCo crashed while compiling it ({signal.Signals(-done.returncode).name})"
    elif "unknown exception" in message:
        message = f"MuJoCo could not compile it within {MOST_MEMORY / 2**30:.0f} GiB of memory"
    if done.returncode != 0:
        raise InputError(f"{path}: broken MJCF: {message}")
