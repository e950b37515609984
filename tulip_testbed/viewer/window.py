"""Where a recording goes: into a file or a window."""

import atexit
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import rerun as rr

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import present, scratch_folder, write_bytes

Log = Callable[[rr.RecordingStream], None]
APPLICATION = "tulip"
END = b"RRF2FOOT"  # of a whole recording
ENDINGS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
LOCAL = ("--bind", "127.0.0.1", "--port", "auto")  # rerun's own default is every address of the machine
OTHERWISE = "`save=FILE.rrd` writes the view; `rerun FILE.rrd --serve-web --bind 127.0.0.1` serves it"
SCRATCH = "tulip-view"
# `rerun` starts the viewer as a child of its own, all in one process group, which ends with this process.
VIEWER = """
import sys
from rerun_cli.__main__ import main
from tulip_testbed.base.workers import end_with
end_with(int(sys.argv.pop(1)))
sys.exit(main())
"""
# What the viewer's last words mean, and what helps on Debian.
FAULTS = {
    ("WGPU", "render context", "graphics adapter", "Vulkan"): (
        "found neither a GPU nor a Vulkan driver, expected one of them: "
        "`apt-get install mesa-vulkan-drivers` gives one in software"
    ),
    ("xkbcommon",): "found no libxkbcommon-x11, expected it: `apt-get install libxkbcommon-x11-0`",
    ("connection to X", "Wayland", "EventLoopError"): "cannot open a window on the display",
}


def save(path: Path, title: str, log: Log) -> int:
    """Write a recording to a file, which appears whole, and return its size [bytes]."""
    with scratch_folder(SCRATCH) as scratch:
        content = _record(scratch, title, log).read_bytes()
    write_bytes(path, content, new=True)
    return len(content)


def check_display() -> None:
    """Refuse a missing screen before anything is computed."""
    found = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not found:
        raise InputError(
            f"found no display (DISPLAY and WAYLAND_DISPLAY are not set), expected one; {OTHERWISE}"
        )


def open_window(title: str, log: Log) -> Callable[[], None]:
    """Open rerun's own viewer until it is closed or this process ends; return what waits for that."""
    check_display()
    kept = ExitStack()
    scratch = kept.enter_context(scratch_folder(SCRATCH))
    viewer, said = kept.enter_context(_viewer(scratch, _record(scratch, title, log)))
    atexit.register(kept.close)

    def closed() -> None:
        if viewer.wait() != 0:
            raise InputError(f"viewer: {_fault(said.read_text(errors='replace'))}; {OTHERWISE}")

    return closed


def _record(folder: Path, title: str, log: Log) -> Path:
    path = folder / "view.rrd"
    recording = rr.RecordingStream(APPLICATION)
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    recording.save(path)
    recording.send_recording_name(title)
    log(recording)
    recording.disconnect()
    if not present(path) or END not in path.read_bytes()[-2 * len(END) :]:
        # rerun tells on stderr at most what it could not write
        raise InputError(f"view: found no end of the recording in {folder}; the disk there may be full")
    return path


@contextmanager
def _viewer(
    folder: Path, recording: Path, options: Sequence[str] = LOCAL
) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Run the viewer with a recording open; yield it and its log file, and end it with the block."""
    said = folder / "viewer.log"
    with said.open("wb") as log:
        viewer = subprocess.Popen(
            [sys.executable, "-c", VIEWER, str(os.getpid()), *options, str(recording)],
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        before = {number: signal.signal(number, _leave) for number in ENDINGS}
        try:
            yield viewer, said
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            if viewer.poll() is None:
                os.killpg(viewer.pid, signal.SIGTERM)
                viewer.wait()


def _leave(number: int, *_: object) -> None:
    """Else a process that is ended, or that loses its terminal, would leave the viewer running."""
    sys.exit(128 + number)


def _fault(said: str) -> str:
    for signs, fault in FAULTS.items():
        if any(sign in said for sign in signs):
            return fault
    lines = [line for line in said.splitlines() if line.strip()] or ["it said nothing"]
    return f"ended with: {lines[-1].strip()[:200]}"
