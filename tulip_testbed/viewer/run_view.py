"""The view of a run, a plan, measurements, or a folder of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.run_file import kind_of
from tulip_testbed.experiments.saved_runs import RunResult, read_run
from tulip_testbed.measurements import Measurements, PosturePlan, read_measurements, read_series
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.shipped import plan_folder
from tulip_testbed.viewer.discovery_view import log_discovery
from tulip_testbed.viewer.montecarlo_view import log_montecarlo
from tulip_testbed.viewer.postures_view import log_postures
from tulip_testbed.viewer.subject import measured, planned, validated
from tulip_testbed.viewer.window import Log


@dataclass(frozen=True)
class View:
    """The content of a window, see `window`.

    Attributes:
        log: called with a recording.
    """

    title: str
    log: Log


def run_view(run: RunResult) -> View:
    """Make the view of a run of any kind."""
    name = run.robot.name if run.folder is None else run.folder.resolve().name
    title = f"{name} ({run.kind})"
    if isinstance(run, Discovered):
        return View(title, partial(log_discovery, discovery=run))
    if isinstance(run, MonteCarlo):
        return View(title, partial(log_montecarlo, run=run))
    return View(title, partial(log_postures, subject=validated(run)))


def plan_view(plan: PosturePlan, robot: Robot, title: str = "plan") -> View:
    """Make the view of a plan: the nominal robot in the planned postures."""
    return View(title, partial(log_postures, subject=planned(plan, robot)))


def measurements_view(measurements: Measurements, robot: Robot) -> View:
    """Make the view of measurements, with an estimate where it can be made."""
    return View("measurements", partial(log_postures, subject=measured(measurements, robot)))


def folder_view(folder: Path, robot: Robot) -> View:
    """Make the view of a folder of a run, a plan (or the name of a shipped one) or measurements."""
    folder = plan_folder(folder)
    kind = kind_of(folder)
    title = f"{folder.resolve().name} ({kind})"
    if kind == "plan":
        return plan_view(read_plan(folder, robot), robot, title)
    if kind == "measurement":
        shown = measured(read_measurements(folder), robot, read_series(folder), str(folder))
        return View(title, partial(log_postures, subject=shown))
    return run_view(read_run(folder, robot))
