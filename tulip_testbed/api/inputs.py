"""Robots and measurements: load, read, write, import; and how every function reads what it is given."""

import atexit
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tulip_testbed.base.arguments import checked
from tulip_testbed.base.errors import InputError, warn
from tulip_testbed.base.files import check_new
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.effects.instance import EffectInstance, Effects, check_different, instances_of
from tulip_testbed.experiments.check_folder import warn_of_faults
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.robot_import.robot_import import import_robot
from tulip_testbed.experiments.robot_report import RobotReport, report_robot
from tulip_testbed.experiments.table_import.import_map import read_map
from tulip_testbed.experiments.table_import.table_import import ImportedTable
from tulip_testbed.experiments.table_import.table_import import import_table as _import_table
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, plan_for
from tulip_testbed.measurements import Measurements, PosturePlan, joined, write_motion
from tulip_testbed.measurements import read_measurements as _read_measurements
from tulip_testbed.measurements import write_measurements as _write_measurements
from tulip_testbed.measurements.contract import check_contract
from tulip_testbed.rendering import standing_picture
from tulip_testbed.sim.plan_folder import check_fits
from tulip_testbed.sim.robot import PUBLISHED, Robot
from tulip_testbed.sim.shipped import TULIP

Measured = Measurements | Run | str | Path
PlanSource = PosturePlan | str | Path

Several = Measured | Sequence[Measured]


@checked
def load_robot(path: str | Path = TULIP) -> Robot:
    """Load a robot and check its description and its model against each other.

    Args:
        path: of the description (TOML), of the folder that `tulip robot` wrote, or of a published MJCF or
            URDF, of which a description is made in a temporary folder; TULip's if left out.

    Raises:
        InputError: names the file, the key, what was found and what was expected.
    """
    path = Path(path)
    if path.suffix.lower() not in PUBLISHED:
        return described_robot(path)
    folder = Path(tempfile.mkdtemp(prefix="tulip-robot-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return described_robot(import_robot(path).write(folder / path.stem).path)


@checked
@one_blas_thread
def describe_robot(
    file: str | Path = TULIP,
    *,
    support: str = "double",
    feet: tuple[str, str] | None = None,
    sole: tuple[float, float, float, float] | None = None,
    out: str | Path | None = None,
) -> RobotReport:
    """Prepare a published MJCF or URDF, or describe a robot.

    Feet, soles, front, drives and a standing posture are found; what the file does not say is assumed and
    listed. The file is not changed. The standard parameters and the base parameters of the robot follow.

    Args:
        file: MJCF or URDF as published, or a description (TOML).
        support: of the base parameters: "double", "right" or "left".
        feet: links of the right and the left foot, if their geometry does not tell.
        sole: how far a sole reaches before and behind the ankle, its width, the ankle's height [m].
        out: new folder for the description of a published robot, which can be edited: robot.toml, robot.xml,
            robot.png.

    Raises:
        InputError: a file that cannot be read, no robot on two legs, or a folder that exists.
    """
    file, place = Path(file), new_place(out)
    if file.suffix.lower() not in PUBLISHED:
        if feet or sole or place is not None:
            found = f"{file}: found a {'folder' if file.is_dir() else 'description'}"
            raise InputError(f"{found}, expected a published MJCF or URDF with feet, sole or out")
        return report_robot(described_robot(file), support)
    made = import_robot(file, feet or (), sole or ())
    with tempfile.TemporaryDirectory() as scratch:
        robot = made.write(Path(scratch) / file.stem) if place is None else made.write(place, _picture)
        description = None if place is None else str(place / robot.path.name)
        more = {"found": made.found, "assumed": made.assumed, "description": description}
        return report_robot(robot, support, made.problems, **more)


def _picture(robot: Robot) -> bytes | None:
    try:
        return standing_picture(robot)
    except InputError as problem:
        warn(f"no picture of the robot: {problem}")
        return None


@checked
def read_measurements(folder: str | Path) -> Measurements:
    """Read and check a measurement folder.

    Raises:
        InputError: the folder breaks the contract; names file, place, what was found and what was expected.
    """
    return _read_measurements(Path(folder))


@checked
def write_measurements(folder: str | Path, measurements: Measurements | Run) -> None:
    """Write a measurement folder, which appears whole or not at all.

    Args:
        folder: the new folder.
        measurements: or a run; that of a plan that moves is written as its samples.

    Raises:
        InputError: measurements that no folder can hold; the folder exists or cannot be written.
    """
    if isinstance(measurements, Measurements):
        _write_measurements(Path(folder), measurements)
    elif measurements.samples is None:
        _write_measurements(Path(folder), measurements.measurements)
    else:
        write_motion(Path(folder), measurements.samples)


@checked
def import_table(
    table: str | Path,
    robot: Robot | None = None,
    *,
    out: str | Path,
    map: Sequence[str] = (),  # noqa: A002  a table's map
) -> ImportedTable:
    """Make a measurement folder of your own table or log.

    The table keeps its names, units and signs; the manifest maps them to the contract's. Columns are found by
    their names, units in brackets. Units that no column name gives have to be stated. Signs are +1 unless
    stated, and are checked against the robot where closed legs, weight and centre of pressure determine them.
    The samples of a log are reduced to rows with rates and accelerations of the joints.

    Args:
        table: CSV or Parquet file, one row a held posture; or a log: such a file, a `.mat`, an `.mcap` of
            ROS 2, or a dumper's folder of devices.
        robot: that was measured; TULip if None.
        out: new measurement folder.
        map: what the table does not say: the path of a TOML file (contacts, columns, units, signs, constant
            joints, how a log is reduced), and entries such as "q.right_knee=RKnee [deg]:deg:-1".

    Returns:
        what was mapped, assumed and is to be decided; its `folder` is None if something necessary is missing.

    Raises:
        InputError: a table or a statement that cannot be read, or a folder that exists.
    """
    check_new(Path(out))
    return _import_table(Path(table), robot or load_robot(), Path(out), read_map(map))


def new_place(out: str | Path | None) -> Path | None:
    """Return where a result is to be written, at which there must be nothing yet; None: nowhere."""
    if out is not None:
        check_new(Path(out))
    return None if out is None else Path(out)


def plan_of(plan: PlanSource | None, robot: Robot) -> PosturePlan:
    """Return a plan that fits the robot: it, or that of a folder or a name; the shipped `random` if None."""
    if not isinstance(plan, PosturePlan):
        return plan_for(robot, None if plan is None else Path(plan))
    check_fits("plan", plan, robot)
    return plan


def plan_name(plan: PlanSource | None) -> str:
    """Return the folder of a plan, for messages."""
    return "plan" if isinstance(plan, PosturePlan) else str(plan or DEFAULT_PLAN)


def corrections_of(corrections: Effects, robot: Robot) -> tuple[EffectInstance, ...]:
    """Return the effects that measurements are corrected for, each at most once."""
    found = instances_of(corrections, robot, "corrections")
    check_different(found, "corrections")
    return found


def each_of(measurements: Several) -> list[Measured]:
    single = isinstance(measurements, Measurements | Run | str | Path)
    return [measurements] if single else list(measurements)  # pyrefly: ignore[bad-argument-type]


def source_of(measurements: Several) -> str | None:
    """Return the folders of measurements, for messages."""
    folders = [str(one) for one in each_of(measurements) if isinstance(one, str | Path)]
    return ", ".join(folders) or None


def measurements_of(
    measured: Several,
    robot: Robot | None = None,
    corrections: Sequence[EffectInstance] = (),
    tolerances: Mapping[str, float] | None = None,
    likely: bool = True,
    refuse: str = "",
) -> Measurements:
    """Return measurements, or those of runs and folders, checked against the contract once and joined.

    Args:
        robot: whose faulty measurements cause a warning or are refused, see `warn_of_faults`, unless they
            were simulated: their faults are on purpose; None: those of any robot, to be looked at.
        refuse: how to go on with gross faults, which are refused then; "": they are not.
    """
    each, found = each_of(measured), []
    for one in each:
        if isinstance(one, str | Path):
            found.append(read_measurements(one))
        else:
            found.append(one.measurements if isinstance(one, Run) else one)
            check_contract(found[-1], likely=likely)
        if robot is not None and not isinstance(one, Run):
            warn_of_faults(found[-1], robot, corrections, source_of(one), tolerances, refuse)
    names = [str(one) if isinstance(one, str | Path) else f"experiment {k + 1}" for k, one in enumerate(each)]
    return joined(found, names)
