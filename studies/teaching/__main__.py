"""Draw the teaching pictures in docs/pictures: `python -m studies.teaching [NAME...]`."""

import os
import sys

# As in studies/__main__.py: before any library is loaded, so that the same figures come out everywhere.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ.setdefault("MUJOCO_GL", "disable")

from studies.teaching.pictures import main

sys.exit(main(sys.argv[1:]))
