"""Functions that show: the view and the report."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.api.inputs import load_robot, measurements_of
from tulip_testbed.base.arguments import checked
from tulip_testbed.base.files import check_new
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.experiments.discovering import Discovered
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.montecarlo.montecarlo_run import MonteCarlo
from tulip_testbed.experiments.records import read_record, record_of
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.robot import Robot

Reported = Run | Validation | Discovered | MonteCarlo | str | Path


Viewed = Reported | Measurements | PosturePlan


@checked
def view(shown: Viewed, robot: Robot | None = None, save: str | Path | None = None) -> None:
    """Look at postures, forces and errors in rerun's viewer, a window of its own.

    Args:
        shown: a run, a validation, a discovery, a Monte Carlo, measurements, a plan, or the folder of any.
        robot: of measurements, a plan or a folder; TULip if None.
        save: write the view as this file (.rrd) instead of showing it, for where there is no screen.

    Raises:
        InputError: no screen and no file; a file that exists, cannot be written or has another ending; what
            cannot be drawn.
    """
    from tulip_testbed.viewer import ENDING, window
    from tulip_testbed.viewer.record_view import folder_view, measurements_view, plan_view, record_view

    if save is not None:
        check_new(Path(save), ENDING)
    robot = robot or load_robot()
    if isinstance(shown, str | Path):
        made = folder_view(Path(shown), robot)
    elif isinstance(shown, PosturePlan):
        made = plan_view(shown, robot)
    elif isinstance(shown, Measurements):
        made = measurements_view(measurements_of(shown), robot)
    else:
        made = record_view(_record(shown))
    if save is None:
        window.open_window(made.title, made.log)
    else:
        window.save(Path(save), made.title, made.log)


@checked
def report(shown: Reported, path: str | Path, robot: Robot | None = None) -> None:
    """Write a run as one HTML page that needs no network: verdict, tables, figures, settings.

    Args:
        shown: a run, which is identified and compared with its truth; a validation, a discovery, a Monte
            Carlo, or the folder of any.
        path: of the page, a new file (.html).
        robot: that the folder's run was made with; TULip if None.

    Raises:
        InputError: the file exists, cannot be written or has another ending; a run that cannot be identified.
    """
    from tulip_testbed.pages import ENDING
    from tulip_testbed.pages.report_page import write_page

    check_new(Path(path), ENDING)
    record = (
        read_record(Path(shown), robot or load_robot()) if isinstance(shown, str | Path) else _record(shown)
    )
    write_page(Path(path), record)


_record = one_blas_thread(record_of)
