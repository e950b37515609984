"""Look at what a person sees: rerun and Chromium without a screen."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rerun.experimental import ViewerClient

SETTLING = 1.5  # s, until a view has drawn what it was told
PATIENCE = 30.0  # s


@contextmanager
def headless_viewer(recording: Path, size: tuple[int, int] = (1600, 1000)) -> Iterator[ViewerClient]:
    """Rerun with a recording open, on a free port of this machine alone.

    Raises:
        RuntimeError: it does not start; with what it said last.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as scratch, tempfile.TemporaryFile("w+") as log:
        command = [sys.executable, "-m", "rerun", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
        command += ["--window-size", f"{size[0]}x{size[1]}"]
        # `rerun` is a wrapper: ending it alone would leave the viewer running.
        process = subprocess.Popen(
            command,
            env=os.environ | {"XDG_RUNTIME_DIR": scratch, "HOME": scratch},
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        try:
            _wait_for_port(port, process, log)
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.open(str(recording.resolve()))
            until = time.monotonic() + PATIENCE
            while client.get_state().loading and time.monotonic() < until:
                time.sleep(0.1)
            time.sleep(SETTLING)
            yield client
        finally:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(timeout=10)


def _wait_for_port(port: int, process: subprocess.Popen, log) -> None:
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if process.poll() is not None:
            break
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    log.seek(0)
    raise RuntimeError(f"rerun did not start: {log.read()[-500:]}")
