"""The console script: ends quietly when interrupted while the libraries are still loading."""

from __future__ import annotations

import os
import signal


def run() -> None:
    """Load the command line and hand over to it."""
    # The last bits of a result must not depend on how many cores a product of small matrices is split over.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    # An exception in the middle of an import would show a traceback, or be lost in a library's own handler.
    signal.signal(signal.SIGINT, _leave)
    # Nothing here draws. Else MuJoCo loads GLFW, whose helper process shows a traceback of its own.
    os.environ.setdefault("MUJOCO_GL", "disable")
    from tulip_testbed.cli import main as cli

    signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.run()


def _leave(*_: object) -> None:
    os.write(2, b"tulip: interrupted; nothing was written\n")
    os._exit(130)
