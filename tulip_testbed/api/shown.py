"""Functions that show: the view and the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tulip_testbed.api.inputs import load_robot, measurements_of
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
from tulip_testbed.experiments.run_file import robot_of
from tulip_testbed.experiments.saved_runs import RunResult, read_run
from tulip_testbed.experiments.validate import judge
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.pages import ENDING
from tulip_testbed.sim.robot import Robot

MEGABYTE = 1e6
Reported = Run | Validation | Discovered | MonteCarlo | str | Path
Viewed = Reported | Measurements | PosturePlan
RunRobot = Robot | None


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
        view: its file. bytes: its size. address: that serves it. closed: waits until the viewer is closed.
    """

    view: str | None = None
    bytes: int | None = None
    address: str | None = None
    closed: Callable[[], None] = lambda: None

    def tables(self) -> list[Table | str]:
        """Return the file or the address; a window says enough itself."""
        if self.address is not None:
            return [f"Open {self.address} in a browser; Ctrl-C ends it."]
        if self.view is None or self.bytes is None:
            return []
        return [f"View: {self.view} ({self.bytes / MEGABYTE:.1f} MB); open it by `rerun {self.view}`"]

    def to_json(self) -> dict[str, Any]:
        """Return the file with its size, or the address."""
        document = {"view": self.view, "bytes": self.bytes, "address": self.address}
        return {key: value for key, value in document.items() if value is not None}

    def wait(self) -> None:
        """Wait until the viewer is closed.

        Raises:
            InputError: it could not draw, or ended by itself.
        """
        self.closed()


@checked
def view(
    shown: Viewed,
    robot: RunRobot = None,
    *,
    save: str | Path | None = None,
    serve: bool = False,
) -> OpenView:
    """Show a plan, measurements or a run in rerun.

    The view shows postures, forces and errors.

    Args:
        shown: a run, a validation, a discovery, a Monte Carlo, measurements, a plan, or the folder of any.
        robot: of measurements or a plan, TULip if None; a run knows its own.
        save: write the view as this file (.rrd) instead of showing it, for where there is no screen.
        serve: serve it to a browser of this machine (127.0.0.1) alone.

    Raises:
        InputError: no screen and no file; a file that exists, cannot be written or has another ending; what
            cannot be drawn.
    """
    from tulip_testbed.viewer import ENDING as RECORDING
    from tulip_testbed.viewer import window  # rerun takes half a second to load
    from tulip_testbed.viewer.run_view import folder_view, measurements_view, plan_view, run_view

    if save is not None and serve:
        raise InputError("save, serve: found both, expected one of them")
    if save is not None:
        check_new(Path(save), RECORDING)
    robot = robot or _robot_of(shown)
    if isinstance(shown, str | Path):
        made = folder_view(Path(shown), robot)
    elif isinstance(shown, PosturePlan):
        made = plan_view(shown, robot)
    elif isinstance(shown, Measurements):
        made = measurements_view(measurements_of(shown), robot)
    else:
        made = run_view(_judged(shown))
    if save is None and not serve:
        window.check_display()
    _warn_of_bare_links(robot)
    if save is not None:
        return OpenView(view=str(save), bytes=window.save(Path(save), made.title, made.log))
    if serve:
        address, closed = window.open_page(made.title, made.log)
        return OpenView(address=address, closed=closed)
    return OpenView(closed=window.open_window(made.title, made.log))


def _warn_of_bare_links(robot: Robot) -> None:
    from tulip_testbed.viewer.robot_view import undrawn

    if bare := undrawn(robot.visual_model):
        warn(
            f"{robot.model_file.name}: no geom shows the links {listed(bare)}; their frames and masses stand "
            "alone"
        )


@checked
def report(
    shown: Reported,
    out: str | Path | None = None,
    other: Reported | None = None,
    robot: RunRobot = None,
) -> WrittenReport | Comparison:
    """Write a run as one HTML page that needs no network.

    The page shows the verdict, tables, figures and settings. With another run the settings and the results of
    both are compared instead; both must be of one robot.

    Args:
        shown: a run, which is identified and compared with its truth; a validation, a discovery, a Monte
            Carlo, or the folder of any.
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
    runs = [
        read_run(Path(one), robot or _robot_of(one)) if isinstance(one, str | Path) else _judged(one)
        for one in (shown, other)
        if one is not None
    ]
    if out is None:
        return compare(*runs)
    from tulip_testbed.pages.run_page import write_page  # loads slowly

    page = write_page(Path(out), runs[0])
    return WrittenReport(str(out), Path(out).stat().st_size, tuple(page.missing))


def _robot_of(shown: Viewed) -> Robot:
    if isinstance(shown, str | Path):
        return load_robot(robot_of(Path(shown)))
    return getattr(shown, "robot", None) or load_robot()


@one_blas_thread
def _judged(result: Run | RunResult) -> RunResult:
    """Return a result; a run is judged as a validation."""
    return judge(result) if isinstance(result, Run) else result
