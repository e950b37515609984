"""The posture plans that come with TULip, and plans of one's own.

`plans.random` holds 150 random postures on 30 foot placements, `plans.optimal` 150 optimised ones, and
`plans.mixed` 108 on both feet, on the right and on the left one; they are read when they are first asked for.
"""

from functools import cache
from pathlib import Path

import numpy as np

from tulip_testbed.base.arguments import checked
from tulip_testbed.experiments.usable_plan import plan_for
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.shipped import PLAN_NAMES, PLANS

SHIPPED = PLAN_NAMES

random: PosturePlan
optimal: PosturePlan
mixed: PosturePlan

__all__ = ["SHIPPED", "mixed", "optimal", "random", "read", "write"]


@checked
def read(folder: str | Path, robot: Robot | None = None) -> PosturePlan:
    """Read and check a plan folder.

    Args:
        folder: or the name of a shipped plan, unless there is such a folder.
        robot: that the plan was made for; TULip if None.

    Raises:
        InputError: no such folder, a plan that breaks the contract, or one for another robot.
    """
    return plan_for(robot or load_robot(), Path(folder))


@checked
def write(folder: str | Path, plan: PosturePlan) -> None:
    """Write a plan folder, which appears whole or not at all.

    Raises:
        InputError: the folder exists or cannot be written.
    """
    write_plan(Path(folder), plan)


@cache
def _shipped(name: str) -> PosturePlan:
    plan = read_plan(PLANS / name, load_robot())
    for values in vars(plan).values():
        if isinstance(values, np.ndarray):
            values.setflags(write=False)  # everyone in the process has the same plan
    return plan


def __getattr__(name: str) -> PosturePlan:
    if name in SHIPPED:
        return _shipped(name)
    raise AttributeError(f"module {__name__!r} has no plan {name!r}; valid: {', '.join(SHIPPED)}")


def __dir__() -> list[str]:
    return list(__all__)
