"""Compile an MJCF in a separate process first, so that a crash or an endless loop of MuJoCo is harmless."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tulip_testbed.base.errors import InputError, shortened

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
for path in sys.argv[1:]:
    try:
        mujoco.MjSpec.from_file(path).compile()
    except Exception as error:
        sys.exit(str(error))
    print("compiled", flush=True)
"""
Hashes = Mapping[Path, str]
# What was compiled without a crash, by the files of each MJCF and their hashes.
compiled: set[tuple[Path, frozenset[tuple[Path, str]]]] = set()


def try_to_compile(path: Path, files: Mapping[Path, Hashes]) -> None:
    """Compile MJCF files in one separate process, each once as long as no file changes.

    Args:
        path: the MJCF that is needed now. The others are compiled along with it, since starting a process
            takes a while; one that fails is tried again when it is needed.
        files: hashes of all files that each MJCF consists of, `path` first.

    Raises:
        InputError: MuJoCo refuses `path`, crashes, or needs too much time or memory.
    """
    new = [
        key for file, hashes in files.items() if (key := (file, frozenset(hashes.items()))) not in compiled
    ]
    if path not in dict(new):
        return
    command = [sys.executable, "-c", CHILD, *(str(file) for file, _ in new)]
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
    good = new[: len(done.stdout.splitlines())]
    compiled.update(good)
    if path in dict(good):
        return
    message = shortened(done.stderr.decode("utf-8", "replace"), 300)
    if done.returncode == -signal.SIGXCPU:
        message = f"MuJoCo did not compile it within {MOST_SECONDS} s of processor time"
    elif done.returncode < 0:
        message = f"MuJoCo crashed while compiling it ({signal.Signals(-done.returncode).name})"
    elif "unknown exception" in message:
        message = f"MuJoCo could not compile it within {MOST_MEMORY / 2**30:.0f} GiB of memory"
    raise InputError(f"{path}: broken MJCF: {message}")
