"""How the command line gives values that are not plain.

Folders and files that the library reads itself are given as paths: `KINDS`. Other values have a reader, whose
parameters are the options of a command. Its own parameter `value` is an option with the name of the
parameter that it reads; its parameter `robot` is what the option --robot reads. Both are found by the
annotation of the parameter. The simulator is loaded when a reader is called: help does not need it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from tulip_testbed.base.errors import InputError
from tulip_testbed.sim.shipped import PLAN_NAMES, TULIP

Corrections = Annotated[
    Path | None,
    tyro.conf.arg(metavar="FOLDER", help="folder of effects that the laboratory is known to have"),
]
SensorsName = Annotated[str, tyro.conf.arg(help="sensors of the laboratory, such as wii or force-plate")]
PlanFolder = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="[PLAN]",
        help=f"plan folder, or the name of a plan shipped for TULip ({', '.join(PLAN_NAMES)}); "
        f"{PLAN_NAMES[0]} if left out",
    ),
]
RUN = Annotated[Path, tyro.conf.arg(metavar="RUN", help="run folder or measurement folder")]
POOL = "plan folder to choose from, or a shipped plan's name; the measured postures if left out"

# By annotation, as the functions of the API have it.
KINDS: dict[str, Any] = {
    "Measured": Annotated[Path, tyro.conf.arg(metavar="FOLDER", help="measurement folder")],
    "Several": Annotated[
        tuple[Path, ...],
        tyro.conf.arg(metavar="FOLDER [FOLDER ...]", help="measurement folders: experiments with one robot"),
    ],
    "Measured | None": Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help="measurements before the plan")
    ],
    "Viewed": Annotated[
        Path, tyro.conf.arg(metavar="FOLDER", help="folder of a run, a plan or measurements")
    ],
    "Exportable": RUN,
    "Proposable": RUN,
    "Reported": RUN,
    "Reported | None": Annotated[
        Path | None, tyro.conf.arg(metavar="[RUN]", help="a second run, to compare")
    ],
    "RunRobot": Annotated[Path | None, tyro.conf.arg(metavar="FILE", help="robot; the run's if left out")],
    "Planned": PlanFolder,
    "PlanSource": Annotated[
        Path,
        tyro.conf.arg(metavar="PLAN", help="plan folder that is being measured, or a shipped plan's name"),
    ],
    "PlanSource | None": PlanFolder,
    "PosturePlan | str | Path | None": Annotated[Path | None, tyro.conf.arg(metavar="PLAN", help=POOL)],
}


def read_robot(
    robot: Annotated[Path, tyro.conf.arg(metavar="FILE", help="description of the robot (TOML)")] = TULIP,
) -> Any:
    """Load the robot."""
    from tulip_testbed.experiments.description import described_robot

    return described_robot(robot)


def read_plan_folder(robot: Any, value: PlanFolder = None) -> Any:
    """Read a plan that fits the robot."""
    from tulip_testbed.experiments.usable_plan import plan_for

    return plan_for(robot, value)


def read_corrections(robot: Any, value: Corrections = None) -> tuple[Any, ...]:
    """Read what a discovery adopted."""
    from tulip_testbed.experiments.rig_folder import read_rig

    return () if value is None else tuple(read_rig(value, robot))


def read_stated_tolerances(
    value: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(
            metavar="FAMILY=VALUE",
            help="what is usual for a family of imperfections of this laboratory (SI units; 0: exact)",
        ),
    ] = (),
) -> Mapping[str, float]:
    """Read tolerances of families."""
    from tulip_testbed.calibration.families import read_tolerances

    return read_tolerances(value)


def read_standard_errors(
    value: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME=MM [NAME=MM ...]",
            help="standard errors at which to stop, in mm, by base parameter or all",
        ),
    ] = (),
) -> Mapping[str, float]:
    """Read standard errors that are wanted."""
    from tulip_testbed.experiments.watching.watch_day import read_targets

    return read_targets(value)


def read_standard_input(
    stdin: Annotated[
        bool, tyro.conf.arg(help="read the rows as CSV lines after a header from standard input")
    ] = False,
) -> Iterable[bytes] | None:
    """Return the lines of standard input, if they are to be read."""
    if stdin and sys.stdin is None:
        raise InputError("stdin: standard input is closed, expected rows")
    return sys.stdin.buffer if stdin else None


def read_plain_laboratory(robot: Any, sensors: SensorsName = "wii", corrections: Corrections = None) -> Any:
    """Set up a laboratory without hidden effects."""
    from tulip_testbed.experiments.laboratory import Laboratory

    return Laboratory(robot, sensors).with_known(*read_corrections(robot, corrections))


def read_laboratory(
    robot: Any,
    sensors: SensorsName = "wii",
    effects: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(
            metavar="NAME[:TARGET]=VALUE[,VALUE]",
            help="physical effects to hide in it (see `tulip atlas`)",
        ),
    ] = (),
    corrections: Corrections = None,
) -> Any:
    """Set up a laboratory."""
    return read_plain_laboratory(robot, sensors, corrections).with_effects(*effects)


READERS: dict[str, Callable[..., Any]] = {
    "Robot | None": read_robot,
    "PosturePlan": read_plan_folder,
    "Effects": read_corrections,
    "Mapping[str, float] | None": read_stated_tolerances,
    "Targets | None": read_standard_errors,
    "Iterable[bytes] | None": read_standard_input,
    "Laboratory": read_laboratory,
    "PlainLaboratory": read_plain_laboratory,
}
