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
DEFAULT_ESTIMATOR = ESTIMATORS[-1]
ORDINARY = 1.0
ENGINES = ("loky", "dask")


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
Sensors = Annotated[Preset, tyro.conf.arg(help="sensors of the laboratory")]
PlateSensors = Annotated[PlatePreset, tyro.conf.arg(help="sensors of the laboratory")]
NoisySensors = Annotated[Noisy, tyro.conf.arg(help="sensors of the laboratory")]
RunFolder = Annotated[Path, tyro.conf.arg(help="run folder to write")]
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
EstimatorName = Annotated[str, tyro.conf.arg(help=f"one of {', '.join(ESTIMATORS)}")]
Imperfections = Annotated[
    float,
    tyro.conf.arg(
        help="scale of ordinary imperfections of all families, which are drawn and hidden in the laboratory "
        "(1: spreads of 0.1 to 1 tolerance; 0: an exact laboratory)",
    ),
]
RigFolder = Annotated[
    Path | None,
    tyro.conf.arg(name="rig", metavar="RIG", help="rig folder: effects that the laboratory is known to have"),
]

EngineName = Annotated[
    str, tyro.conf.arg(metavar="{" + ",".join(ENGINES) + "}", help="where the work is done")
]
Address = Annotated[
    str | None, tyro.conf.arg(metavar="tcp://HOST:PORT", help="address of the scheduler, with --engine dask")
]

CORES = os.cpu_count() or 1
