"""How the command line gives what is no plain value: a reader's parameters are the options of a command.

A reader whose parameter is called `value` has one option, named as the function's parameter; `robot` is what
the option --robot reads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from tulip_testbed.api.inputs import Measured, Several
from tulip_testbed.api.measured import Exportable
from tulip_testbed.calibration.families import read_tolerances
from tulip_testbed.effects.instance import EffectInstance, Effects
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.experiments.usable_plan import plan_for
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.shipped import PLAN_NAMES, TULIP

Corrections = Annotated[
    Path | None,
    tyro.conf.arg(metavar="FOLDER", help="folder of effects that the laboratory is known to have"),
]
PlanFolder = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="PLAN",
        help=f"plan folder, or the name of a plan shipped for TULip ({', '.join(PLAN_NAMES)}); "
        f"{PLAN_NAMES[0]} if left out",
    ),
]


def read_robot(
    robot: Annotated[Path, tyro.conf.arg(metavar="FILE", help="description of the robot (TOML)")] = TULIP,
) -> Robot:
    """Load the robot."""
    return described_robot(robot)


def read_folder(
    value: Annotated[Path, tyro.conf.arg(metavar="FOLDER", help="measurement folder")],
) -> Path:
    """Name one measurement folder, which the library reads."""
    return value


def read_folders(
    value: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(metavar="FOLDER [FOLDER ...]", help="measurement folders: experiments with one robot"),
    ],
) -> list[Path]:
    """Name measurement folders, which the library reads."""
    return list(value)


def read_run(
    value: Annotated[Path, tyro.conf.arg(metavar="RUN", help="run folder or measurement folder")],
) -> Path:
    """Name a run folder, which the library reads."""
    return value


def read_plan_folder(robot: Robot, value: PlanFolder = None) -> PosturePlan:
    """Read a plan that fits the robot."""
    return plan_for(robot, value)


def read_corrections(robot: Robot, value: Corrections = None) -> tuple[EffectInstance, ...]:
    """Read what a discovery adopted."""
    return () if value is None else tuple(read_rig(value, robot))


def read_stated_tolerances(
    value: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="FAMILY=VALUE [FAMILY=VALUE ...]",
            help="what is usual for a family of imperfections of this laboratory (SI units; 0: exact)",
        ),
    ] = (),
) -> Mapping[str, float]:
    """Read tolerances of families."""
    return read_tolerances(value)


def read_laboratory(
    robot: Robot,
    sensors: Annotated[str, tyro.conf.arg(help="sensors of the laboratory")] = "wii",
    effects: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME[:TARGET]=VALUE[,VALUE] [...]",
            help="physical effects to hide in it (see `tulip atlas`)",
        ),
    ] = (),
    corrections: Corrections = None,
) -> Laboratory:
    """Set up a laboratory."""
    return Laboratory(robot, sensors).with_known(*read_corrections(robot, corrections)).with_effects(*effects)


READERS: dict[Any, Callable[..., Any]] = {
    Robot | None: read_robot,
    Measured: read_folder,
    Several: read_folders,
    Exportable: read_run,
    PosturePlan: read_plan_folder,
    Effects: read_corrections,
    Mapping[str, float] | None: read_stated_tolerances,
    Laboratory: read_laboratory,
}
