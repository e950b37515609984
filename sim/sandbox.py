"""Read models in a separate process first, so that a crash or an endless loop of MuJoCo is harmless."""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from tulip_testbed.base.errors import InputError, shortened

MOST_SECONDS = 20  # of processor time
MOST_MEMORY = 4 * 2**30  # bytes
MOST_WAIT = 300  # seconds, for busy machines
UNKNOWN = "unknown exception"  # MuJoCo's words for an allocation that failed

LIMITS = """
import os, pickle, resource, sys
memory, seconds = map(int, sys.argv[1:3])
resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
"""
CHILD = f"""
import mujoco
{LIMITS}
mujoco.set_mju_user_warning(lambda message: None)
for path in sys.argv[3:]:
    try:
        mujoco.MjSpec.from_file(path).compile()
    except Exception as error:
        sys.exit(str(error))
    print("compiled", flush=True)
"""
# Libraries print where they like: the answer has a descriptor of its own.
CALL = f"""
{LIMITS}
answer = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)
sys.path[:] = pickle.load(sys.stdin.buffer)
function, path = pickle.load(sys.stdin.buffer)
try:
    found = function(path)
except Exception as error:
    found = error
pickle.dump(found, answer)
"""
T = TypeVar("T")
Hashes = Mapping[Path, str]
# What was compiled without a crash, by the files of each MJCF and their hashes.
compiled: set[tuple[Path, frozenset[tuple[Path, str]]]] = set()


def try_to_compile(path: Path, files: Mapping[Path, Hashes]) -> None:
    """Compile MJCF files in one separate process, each once as long as no file changes.

    Args:
        path: the MJCF that is needed now. The others are compiled along with it, since starting a process
            takes a while; one that fails is tried again when it is needed.
        files: hashes of all files that each MJCF consists of, `path` first.
    """
    new = [
        key for file, hashes in files.items() if (key := (file, frozenset(hashes.items()))) not in compiled
    ]
    if path not in dict(new):
        return
    done = _run(path, CHILD, [str(file) for file, _ in new])
    good = new[: len(done.stdout.splitlines())]
    compiled.update(good)
    if path not in dict(good):
        raise _refusal(path, done.returncode, done.stderr.decode("utf-8", "replace"))


def call_safely(function: Callable[[Path], T], path: Path) -> T:
    """Call a function of a module with a file in a separate process; what it returns or raises is pickled.

    Raises:
        InputError: it crashes, or needs too much time or memory.
        Exception: what the function raises.
    """
    done = _run(path, CALL, [], pickle.dumps(sys.path) + pickle.dumps((function, path)))
    if done.returncode:
        raise _refusal(path, done.returncode, done.stderr.decode("utf-8", "replace"))
    found = pickle.loads(done.stdout)
    if isinstance(found, Exception):
        lacks_memory = isinstance(found, MemoryError) or UNKNOWN in str(found)
        raise _refusal(path, 0, UNKNOWN) if lacks_memory else found
    return found


def _refusal(path: Path, code: int, words: str) -> InputError:
    message = shortened(words, 300)
    if code == -signal.SIGXCPU:
        message = f"MuJoCo did not compile it within {MOST_SECONDS} s of processor time"
    elif code < 0:
        message = f"MuJoCo crashed while compiling it ({signal.Signals(-code).name})"
    elif UNKNOWN in message:
        message = f"MuJoCo could not compile it within {MOST_MEMORY / 2**30:.0f} GiB of memory"
    return InputError(f"{path}: broken MJCF: {message}")


def _run(path: Path, code: str, words: list[str], given: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    # More threads would only take address space.
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MUJOCO_GL": "disable"}
    command = [sys.executable, "-c", code, str(MOST_MEMORY), str(MOST_SECONDS), *words]
    try:
        return subprocess.run(
            command, capture_output=True, env=environment, timeout=MOST_WAIT, check=False, input=given
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: broken MJCF: MuJoCo did not compile it within {MOST_WAIT} s") from None
