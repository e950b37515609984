"""Work that ends the process which carries it out; a module that loads nothing, as every worker loads it."""

import os
import signal


def die(runs):
    """End as the system ends a process that takes too much memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def crash(runs):
    """End by a fault of its own."""
    os.kill(os.getpid(), signal.SIGSEGV)


def unreadable(runs):
    """Return what the process that asked for it cannot read."""
    return _Unreadable()


class _Unreadable:
    def __reduce__(self):
        return _refuse, ()


def _refuse():
    raise ValueError("not to be read")
