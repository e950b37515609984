"""The view of a run, a plan, measurements, or a folder of them."""

from functools import partial
from pathlib import Path

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.run_file import kind_of
from tulip_testbed.experiments.saved_runs import RunResult, read_run
from tulip_testbed.measurements import Measurements, PosturePlan, read_measurements
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.shipped import plan_folder
from tulip_testbed.viewer.discovery_view import log_discovery
from tulip_testbed.viewer.postures_view import log_postures
from tulip_testbed.viewer.subject import measured, planned, validated
from tulip_testbed.viewer.window import Log


def view_of(shown: RunResult | PosturePlan | Measurements | Path, robot: Robot) -> tuple[str, Log]:
    """Return the title of a view, of a result or of a folder (or a shipped plan's name), and what logs it."""
    title, source = "", "measurements"
    if isinstance(shown, Path):
        folder = plan_folder(shown)
        kind = kind_of(folder)
        title, source = f"{folder.resolve().name} ({kind})", str(folder)
        if kind == "measurement":
            shown = read_measurements(folder)
        else:
            shown = read_plan(folder, robot) if kind == "plan" else read_run(folder, robot)
    if isinstance(shown, PosturePlan):
        return title or "plan", partial(log_postures, subject=planned(shown, robot))
    if isinstance(shown, Measurements):
        return title or source, partial(log_postures, subject=measured(shown, robot, source))
    if isinstance(shown, MonteCarlo):
        raise InputError(
            f"{shown.folder or 'shown'}: found a Monte Carlo, which `report` shows; expected a plan, "
            "measurements, a run or a discovery"
        )
    name = shown.robot.name if shown.folder is None else shown.folder.resolve().name
    title = f"{name} ({shown.kind})"
    if isinstance(shown, Discovered):
        return title, partial(log_discovery, discovery=shown)
    return title, partial(log_postures, subject=validated(shown))
