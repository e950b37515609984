"""A day for the tests of `tulip watch`: measured once, and as a folder that grows."""

import json
from pathlib import Path

import numpy as np

from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.watching.day_model import DayModel, day_model
from tulip_testbed.experiments.watching.watch_row import Verdict, watch_row
from tulip_testbed.experiments.watching.watch_state import WatchState, first_state
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.measurement_folder import write_measurements
from tulip_testbed.sim.robot import Robot

SEED = 3


def measured_day(robot: Robot, plan: PosturePlan, preset: str = "force-plate") -> Measurements:
    """Measure the plan's first placements by statics."""
    few = plan.take(plan.placement <= 9)
    return Laboratory(robot, preset).run(few, SEED, "statics").measurements


def one_row(rows: Measurements, k: int) -> Measurements:
    """Return one row."""
    return rows.take(np.array([k]))


def play(
    model: DayModel, rows: Measurements, state: WatchState | None = None, targets: np.ndarray | None = None
) -> tuple[WatchState, list[Verdict]]:
    """Play rows one after the other."""
    state, out = state or first_state(model), []
    for k in range(len(rows)):
        state, verdict = watch_row(model, state, one_row(rows, k), targets)
        out.append(verdict)
    return state, out


def model_of(robot: Robot, plan: PosturePlan, rows: Measurements) -> DayModel:
    """Prepare the watch of a day."""
    return day_model(plan, robot, rows)


def growing_folder(folder: Path, rows: Measurements) -> list[str]:
    """Write a measurement folder whose table has its header alone; return the lines of its rows."""
    write_measurements(folder, rows)
    (folder / "postures.parquet").unlink()
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["tables"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    header, *lines = (folder / "postures.csv").read_text().splitlines(keepends=True)
    (folder / "postures.csv").write_text(header)
    return lines
