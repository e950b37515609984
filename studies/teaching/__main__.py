"""Draw the signatures of effects in docs/pictures: `python -m studies.teaching`."""

import os

# As in studies/__main__.py: before any library is loaded, so that the same figures come out everywhere.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ.setdefault("MUJOCO_GL", "disable")

from studies.teaching.signature_pictures import catalogue_pictures
from studies.teaching.style import DOCS

for path in catalogue_pictures(DOCS / "signatures"):
    print(f"{path.relative_to(DOCS.parents[1])}: {path.stat().st_size / 1e3:.0f} kB")
