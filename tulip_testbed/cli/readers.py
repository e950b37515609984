"""How the command line gives what is no plain value: a reader's parameters are the options of a command.

A reader is found by the annotation of the parameter that it reads. Its own parameter `value` is an option
with the name of that parameter; its parameter `robot` is what the option --robot reads. The simulator is
loaded when a reader is called: help does not need it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

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


def read_robot(
    robot: Annotated[Path, tyro.conf.arg(metavar="FILE", help="description of the robot (TOML)")] = TULIP,
) -> Any:
    """Load the robot."""
    from tulip_testbed.experiments.description import described_robot

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


def read_second_run(
    value: Annotated[Path | None, tyro.conf.arg(metavar="[RUN]", help="a second run, to compare")] = None,
) -> Path | None:
    """Name a second run folder, which the library reads."""
    return value


def read_earlier(
    value: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help="measurements before the plan")
    ] = None,
) -> Path | None:
    """Name a measurement folder, which the library reads."""
    return value


def read_pool(
    value: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="PLAN",
            help="plan folder to choose from, or a shipped plan's name; the measured postures if left out",
        ),
    ] = None,
) -> Path | None:
    """Name a plan, which the library reads."""
    return value


def read_viewed(
    value: Annotated[Path, tyro.conf.arg(metavar="FOLDER", help="folder of a run, a plan or measurements")],
) -> Path:
    """Name a folder, which the library reads."""
    return value


def read_plan_name(value: PlanFolder = None) -> Path | None:
    """Name a plan, which the library reads."""
    return value


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


# By annotation, as the functions of the API have it.
READERS: dict[str, Callable[..., Any]] = {
    "Robot | None": read_robot,
    "Measured": read_folder,
    "Several": read_folders,
    "Exportable": read_run,
    "Viewed": read_viewed,
    "Proposable": read_run,
    "Measured | None": read_earlier,
    "PosturePlan | str | Path | None": read_pool,
    "Reported": read_run,
    "Reported | None": read_second_run,
    "PosturePlan": read_plan_folder,
    "PlanSource | None": read_plan_name,
    "Effects": read_corrections,
    "Mapping[str, float] | None": read_stated_tolerances,
    "Laboratory": read_laboratory,
    "PlainLaboratory": read_plain_laboratory,
    "Planned": read_plan_name,
}
