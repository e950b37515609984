"""Options that several commands share.

What the library defines is repeated here, so that help does not load it; a test compares both.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import tyro

DEFAULT_SEED = 1
ESTIMATORS = (
    "mixed-model",
    "least-squares",
    "placement",
    "errors-in-variables",
    "robust",
    "prior",
    "consistent",
    "self-calibrating",
)
DEFAULT_ESTIMATOR = ESTIMATORS[0]
SOLVERS = ("slsqp", "ipopt")
HOPS = 60
ENGINES = ("loky", "dask")

Preset = Literal["wii", "force-plate", "ideal"]
Noisy = Literal["wii", "force-plate"]
NoisyPreset = Annotated[
    Noisy, tyro.conf.arg(help="sensors whose noise the standard errors are predicted for")
]
Plan = Annotated[
    Path | None,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="[PLAN]", help="plan folder; the shipped plan, TULip's, if left out"),
]
RobotFile = Annotated[Path, tyro.conf.arg(name="robot", help="robot description (TOML)")]
Json = Annotated[bool, tyro.conf.arg(name="json", help="print one JSON document on stdout instead of tables")]
Seed = Annotated[int, tyro.conf.arg(help="seed of everything random")]
Workers = Annotated[int, tyro.conf.arg(help="processes; results do not depend on it")]
EstimatorName = Annotated[str, tyro.conf.arg(help=f"one of {', '.join(ESTIMATORS)}")]
RigFolder = Annotated[
    Path | None,
    tyro.conf.arg(name="rig", metavar="RIG", help="rig folder: effects that the laboratory is known to have"),
]

CORES = os.cpu_count() or 1
