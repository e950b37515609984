"""Run a study: `python -m studies NAME`; `python -m studies --help` lists them."""

import os
import sys

# Before any library is loaded. Studies call functions below those that limit linear algebra to one thread
# (base/threads.py), also in joblib's workers, which inherit the variable: with two threads the last bits of a
# discovery differ. Nothing here draws by OpenGL.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ.setdefault("MUJOCO_GL", "disable")

from studies.runner import main

sys.exit(main(sys.argv[1:]))
