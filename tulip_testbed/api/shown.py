"""Functions that show: the view and the report."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tulip_testbed.api.inputs import load_robot, measurements_of, plan_of
from tulip_testbed.base.arguments import checked
from tulip_testbed.base.errors import InputError, listed, warn
from tulip_testbed.base.files import check_new
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.experiments.comparison import Comparison, compare
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.predict import Prediction
from tulip_testbed.experiments.run_file import robot_of
from tulip_testbed.experiments.saved_runs import RunResult, read_run
from tulip_testbed.experiments.validate import judge
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.pages import ENDING
from tulip_testbed.sim.robot import Robot

RunShown = Run | Validation | Discovered | MonteCarlo | str | Path
Reported = RunShown | Prediction
Viewed = RunShown | Measurements | PosturePlan
RunRobot = Robot | None
MEGABYTE = 1e6


@dataclass(frozen=True, repr=False)
class WrittenReport(Result):
    """A page that was written.

    Attributes:
        report: its file. bytes: its size. left_out: pictures that could not be drawn, and why.
    """

    report: str
    bytes: int
    left_out: tuple[str, ...]

    def tables(self) -> list[Table | str]:
        """Return what was left out, and the file."""
        missing = [f"Left out: {note}" for note in self.left_out]
        return [*missing, f"Report: {self.report} ({self.bytes / MEGABYTE:.1f} MB)"]


@dataclass(frozen=True, repr=False)
class OpenView(Result):
    """A view that was written, or that is open.

    Attributes:
        view: its file. bytes: its size. closed: waits until the viewer is closed.
    """

    view: str | None = None
    bytes: int | None = None
    closed: Callable[[], None] = lambda: None

    def tables(self) -> list[Table | str]:
        """Return the file; a window says enough itself."""
        if self.view is None or self.bytes is None:
            return []
        return [f"View: {self.view} ({self.bytes / MEGABYTE:.1f} MB); open it by `rerun {self.view}`"]

    def to_json(self) -> dict[str, Any]:
        """Return the file with its size."""
        document = {"view": self.view, "bytes": self.bytes}
        return {key: value for key, value in document.items() if value is not None}

    def wait(self) -> None:
        """Wait until the viewer is closed.

        Raises:
            InputError: it could not draw, or ended by itself.
        """
        self.closed()


@checked
def view(shown: Viewed, robot: RunRobot = None, *, save: str | Path | None = None) -> OpenView:
    """Show a plan, measurements or a run in rerun.

    The view shows postures, forces and errors.

    Args:
        shown: a run, a validation, a discovery, measurements, a plan, or the folder of any.
        robot: of measurements or a plan, TULip if None; a run knows its own.
        save: write the view as this file (.rrd) instead of showing it, for where there is no screen.

    Raises:
        InputError: no screen and no file; a file that exists, cannot be written or has another ending; what
            cannot be drawn.
    """
    from tulip_testbed.viewer import ENDING as RECORDING
    from tulip_testbed.viewer import window  # rerun takes half a second to load
    from tulip_testbed.viewer.robot_view import undrawn
    from tulip_testbed.viewer.run_view import view_of

    if save is not None:
        check_new(Path(save), RECORDING)
    robot = robot or _robot_of(shown)
    if isinstance(shown, str | Path):
        title, log = view_of(Path(shown), robot)
    elif isinstance(shown, PosturePlan):
        title, log = view_of(plan_of(shown, robot), robot)
    elif isinstance(shown, Measurements):
        title, log = view_of(measurements_of(shown), robot)
    else:
        title, log = view_of(_judged(shown), robot)
    if save is None:
        window.check_display()
    if bare := undrawn(robot.visual_model):
        warn(f"{robot.model_file.name}: no geom shows {listed(bare)}; boxes of their inertia stand for them")
    if save is not None:
        return OpenView(view=str(save), bytes=window.save(Path(save), title, log))
    return OpenView(closed=window.open_window(title, log))


@checked
def report(
    shown: Reported, out: str | Path | None = None, other: Reported | None = None, robot: RunRobot = None
) -> WrittenReport | Comparison:
    """Write a run as one HTML page that needs no network.

    The page shows the verdict, tables, figures and settings. With another run the settings and the results of
    both are compared instead; both must be of one robot.

    Args:
        shown: a run, which is identified and compared with its truth; a validation, a discovery, a Monte
            Carlo, or the folder of any; a prediction, or the JSON file of one.
        out: the page, a new file (.html).
        other: a second run, to compare.
        robot: that the folder's run was made with; None: the copy there, or else TULip.

    Raises:
        InputError: the file exists, cannot be written or has another ending; a run that cannot be identified;
            runs that cannot be compared.
    """
    if (out is None) == (other is None):
        found = "neither" if out is None else "both"
        raise InputError(f"out, other: found {found}, expected a page to write or a run to compare with")
    if out is not None:
        check_new(Path(out), ENDING)
    runs = [_reported(one, robot) for one in (shown, other) if one is not None]
    if out is None:
        compared = [one for one in runs if not isinstance(one, Prediction)]
        if len(compared) < len(runs):
            raise InputError("shown, other: found a prediction, expected two runs to compare")
        return compare(*compared)
    from tulip_testbed.pages.run_page import write_page  # loads slowly

    page = write_page(Path(out), runs[0])
    return WrittenReport(str(out), Path(out).stat().st_size, tuple(page.missing))


def _reported(shown: Reported, robot: Robot | None) -> RunResult | Prediction:
    """Return what is reported, read from its file or folder; a run is judged as a validation."""
    if isinstance(shown, Prediction):
        return shown
    if isinstance(shown, str | Path):
        path = Path(shown)
        return Prediction.read(path) if path.suffix == ".json" else read_run(path, robot or _robot_of(path))
    return _judged(shown)


def _robot_of(shown: Viewed) -> Robot:
    if isinstance(shown, str | Path):
        return load_robot(robot_of(Path(shown)))
    known = getattr(shown, "robot", None)  # of a plan or measurements, the name of its file
    return known if isinstance(known, Robot) else load_robot()


@one_blas_thread
def _judged(result: Run | RunResult) -> RunResult:
    """Return a result; a run is judged as a validation.

    Raises:
        InputError: measurements of a run that do not suffice to identify the robot.
    """
    return judge(result) if isinstance(result, Run) else result
