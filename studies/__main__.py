"""Run a study: `python -m studies NAME`; `python -m studies --help` lists them."""

import os
import sys

# As in tulip_testbed.cli.entry, before any library is loaded: the last bits of a result must not depend on
# the number of cores, and nothing here draws by OpenGL.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ.setdefault("MUJOCO_GL", "disable")

from studies.runner import main

sys.exit(main(sys.argv[1:]))
