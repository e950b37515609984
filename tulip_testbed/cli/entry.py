"""The console script: ends quietly when interrupted while the libraries are still loading."""

import gc
import os
import signal
import sys


def run() -> None:
    """Print the version, or load the command line and hand over to it."""
    # An exception in the middle of an import would show a traceback, or be lost in a library's own handler.
    signal.signal(signal.SIGINT, _leave)
    if sys.argv[1:2] == ["--version"]:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"tulip {version('tulip-testbed')}")
        except PackageNotFoundError:
            print("tulip not installed")
        sys.exit(0)
    # Nothing here draws. Else MuJoCo loads GLFW, whose helper process shows a traceback of its own.
    os.environ.setdefault("MUJOCO_GL", "disable")
    gc.disable()  # of what libraries load, nothing is garbage: a sixth of the time
    from tulip_testbed.cli import main as cli

    cli.run(_begin)


def _begin() -> None:
    """Begin the work, the libraries being loaded: an interruption is an exception from now on."""
    gc.freeze()
    gc.enable()
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(*_: object) -> None:
    os.write(2, b"tulip: interrupted; nothing was written\n")
    os._exit(130)
