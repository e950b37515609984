"""Work that ends the process which carries it out; a module that loads nothing, as every worker loads it."""

import os
import signal


def die(runs):
    """End as the system ends a process that takes too much memory."""
    os.kill(os.getpid(), signal.SIGKILL)
