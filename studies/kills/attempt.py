"""Start a command, disturb it, and wait until the last of its processes is gone."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import tempfile
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies.kills.commands import Command

MARK = "TULIP_STUDY_MARK"  # in the environment of a command and of all that it starts
PATIENCE = 60.0  # s, until the last process of a killed command has to be gone
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
OF_TERMINALS = (signal.SIGINT, signal.SIGHUP)  # which a terminal sends to the whole group


@dataclass(frozen=True)
class Started:
    """A command that runs, with what it says on stderr."""

    process: subprocess.Popen[bytes]
    mark: str
    log: int

    def said(self) -> str:
        # Reading as usual would move the position at which the command writes.
        return os.pread(self.log, os.fstat(self.log).st_size, 0).decode(errors="replace")

    def disturb(self, number: signal.Signals) -> None:
        """Send a signal, to the whole group if a terminal would."""
        if number in OF_TERMINALS:
            os.killpg(self.process.pid, number)
        else:
            os.kill(self.process.pid, number)

    def gone_after(self) -> float:
        """Wait for the end of all its processes; the seconds that it took, or infinity."""
        began = time.perf_counter()
        self.process.wait(PATIENCE)
        while left := marked(self.mark):
            if time.perf_counter() - began > PATIENCE:
                for number in left:
                    os.kill(number, signal.SIGKILL)
                return math.inf
            time.sleep(0.05)
        return time.perf_counter() - began


@dataclass(frozen=True)
class End:
    """How a command ended.

    Attributes:
        code: exit code. said: on stderr.
        total, writing: seconds from its start, and from the first hidden file, to the last name.
        wrote: whether there was a hidden file when the signal came.
        gone: seconds from the signal until its last process was gone.
    """

    code: int
    said: str
    total: float
    writing: float
    wrote: bool
    gone: float


def start(
    command: Command, place: Path, prefix: tuple[str, ...] = (), before: Callable[[], Any] | None = None
) -> Started:
    """Start a command in its folder; what is temporary lies in `tmp` there.

    Args:
        prefix: of the command line. before: called in the new process.
    """
    mark = uuid.uuid4().hex

    def prepare() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which a study under `nohup` would pass on ignored
        if before is not None:
            before()

    (place / "tmp").mkdir(exist_ok=True)
    here = dict.fromkeys(("TMPDIR", "JOBLIB_TEMP_FOLDER"), str(place / "tmp"))
    descriptor, name = tempfile.mkstemp()
    os.unlink(name)
    process = subprocess.Popen(
        [*prefix, *command.line],
        cwd=place,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=descriptor,
        env=os.environ | here | {MARK: mark},
        start_new_session=True,
        preexec_fn=prepare,
    )
    return Started(process, mark, descriptor)


def marked(mark: str) -> list[int]:
    """Return the numbers of the processes with a mark, regardless of their present parent."""
    wanted, found = f"{MARK}={mark}".encode(), []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if wanted in (path / "environ").read_bytes():
                found.append(int(path.name))
        except OSError:
            continue
    return found


def attempt(
    command: Command,
    place: Path,
    number: signal.Signals = signal.SIGKILL,
    after: float = math.inf,
    aimed: bool = False,
) -> End:
    """Run a command, and send a signal some seconds after its start or, aimed, its first hidden file."""
    old, last = at_work(place), place / command.last
    started = start(command, place)
    process, now = started.process, (began := time.perf_counter())
    wrote = named = sent = math.inf
    while process.poll() is None:
        now = time.perf_counter()
        if wrote == math.inf and at_work(place) - old:
            wrote = now
        if named == math.inf and last.exists():
            named = now
        if sent == math.inf and now > (wrote if aimed else began) + after:
            sent = now
            started.disturb(number)
        if sent < math.inf and now > sent + PATIENCE:
            process.kill()
            break
        time.sleep(0.002)
    gone, named = started.gone_after() + now - min(sent, now), min(named, now)
    return End(
        process.returncode, started.said(), named - began, named - wrote, wrote <= sent < math.inf, gone
    )


def at_work(place: Path) -> set[Path]:
    """Return what is hidden and holds something; commands look at once whether they may make a folder.

    It lies in the folder or, as a view's recording, among the temporary files.
    """
    hidden = [*place.glob(".*"), *(place / "tmp").glob(".*")]
    return {path for path in hidden if path.is_file() or (path.is_dir() and any(path.iterdir()))}
