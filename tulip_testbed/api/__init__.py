"""The functions that a researcher calls; `tulip_testbed` offers them all by name.

Every function uses one thread for linear algebra, so that a notebook and the command line give the same bits.
"""

from tulip_testbed.api import inputs, measured, planned, shown, simulated

__all__ = ["inputs", "measured", "planned", "shown", "simulated"]
