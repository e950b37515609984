"""What the studies share: the shipped plan, parts of plans and folders, Markdown tables."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.sim.measurements import Measurements, PosturePlan, read_plan
from tulip_testbed.sim.robot import Robot

MEASURED_ROWS = (
    *("posture", "placement", "support", "time", "window", "samples", "joint_angles", "joint_angles_sd"),
    *("command", "motor", "cell_forces", "cell_forces_sd", "plate_poses"),
)


def shipped_plan(robot: Robot, placements: int | None = None) -> PosturePlan:
    """The shipped plan, or its first placements."""
    plan = read_plan(DEFAULT_PLAN, robot)
    return plan if placements is None else part_of(plan, plan.placement <= placements)


def part_of(plan: PosturePlan, rows: np.ndarray) -> PosturePlan:
    """Some rows of a plan."""
    return plan.take(rows)


def rows_of(m: Measurements, rows: np.ndarray) -> Measurements:
    """Some rows of a measurement folder."""
    chosen: dict[str, Any] = {
        name: getattr(m, name)[rows] for name in MEASURED_ROWS if getattr(m, name) is not None
    }
    return dataclasses.replace(m, **chosen)


def row(*cells: object) -> str:
    """One line of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def header(*cells: str) -> str:
    """A Markdown table's first two lines."""
    return f"{row(*cells)}\n{'|---' * len(cells)}|"
