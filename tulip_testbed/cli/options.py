"""Options that several commands share.

Definitions of the library are repeated here, so that help does not load it; a test compares both.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import tyro

from tulip_testbed.sim.shipped import PLAN_NAMES

DEFAULT_SEED = 1

Preset = Literal[
    "wii",
    "force-plate",
    "ideal",
    "plate-ft",
    "plate-cop",
    "foot-ft",
    "foot-ideal",
    "sole-ft",
    "sole-3axis",
]
PlatePreset = Literal["wii", "force-plate", "ideal"]
Noisy = Literal["wii", "force-plate"]
PlateSensors = Annotated[PlatePreset, tyro.conf.arg(help="sensors of the laboratory")]
NoisySensors = Annotated[Noisy, tyro.conf.arg(help="sensors of the laboratory")]
FOLDERS = tyro.conf.arg(metavar="FOLDER [FOLDER ...]", help="measurement folders: experiments with one robot")
Plan = Annotated[
    Path | None,
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="[PLAN]",
        help=f"plan folder, or the name of a plan shipped for TULip ({', '.join(PLAN_NAMES)}); "
        f"{PLAN_NAMES[0]} if left out",
    ),
]
RobotFile = Annotated[Path, tyro.conf.arg(name="robot", help="robot description (TOML)")]
Json = Annotated[bool, tyro.conf.arg(name="json", help="print one JSON document on stdout instead of tables")]
Seed = Annotated[int, tyro.conf.arg(help="seed of everything random")]
Workers = Annotated[int, tyro.conf.arg(help="processes; results do not depend on it")]
TolerancesOf = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(
        metavar="FAMILY=VALUE",
        help="what is usual for a family of ordinary imperfections of this laboratory (SI units; 0: exact)",
    ),
]

CORES = os.cpu_count() or 1
