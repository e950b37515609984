"""Options that several commands share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import tyro

from tulip_testbed.identification.estimators import ESTIMATORS

Preset = Literal["wii", "force-plate", "ideal"]
NoisyPreset = Annotated[
    Literal["wii", "force-plate"],
    tyro.conf.arg(help="sensors whose noise the standard errors are predicted for"),
]
Plan = Annotated[
    Path | None,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="[PLAN]", help="plan folder; the shipped plan, TULip's, if left out"),
]
RobotFile = Annotated[Path, tyro.conf.arg(name="robot", help="robot description (TOML)")]
Json = Annotated[bool, tyro.conf.arg(name="json", help="one JSON document on stdout instead of tables")]
Seed = Annotated[int, tyro.conf.arg(help="seed of everything random")]
Workers = Annotated[int, tyro.conf.arg(help="processes; results do not depend on it")]
EstimatorName = Annotated[str, tyro.conf.arg(help=f"one of {', '.join(ESTIMATORS)}")]
RigFolder = Annotated[
    Path | None,
    tyro.conf.arg(name="rig", metavar="RIG", help="rig folder: effects that the laboratory is known to have"),
]

CORES = os.cpu_count() or 1
