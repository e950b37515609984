"""The functions that a researcher calls; `tulip_testbed` offers them all by name.

Every function uses one thread for linear algebra, so that a notebook and the command line give the same bits.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING
from tulip_testbed.effects.instance import EffectInstance, Effects, check_different, instances_of
from tulip_testbed.experiments.atlases.effect_atlas import Atlas
from tulip_testbed.experiments.atlases.effect_atlas import atlas as _atlas
from tulip_testbed.experiments.atlases.planned_experiment import planned
from tulip_testbed.experiments.campaigns.campaign_run import Campaign, campaign_settings
from tulip_testbed.experiments.campaigns.campaign_run import campaign as _campaign
from tulip_testbed.experiments.check_folder import (
    Preflight,
    check_folder,
    check_measurements,
    warn_of_faults,
)
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.discovering import Discovered, discover_effects
from tulip_testbed.experiments.discovery_record import read_discovery
from tulip_testbed.experiments.export.export_model import SAMPLES, Export
from tulip_testbed.experiments.export.export_model import export_model as _export_model
from tulip_testbed.experiments.export.exported_model import ExportedModel
from tulip_testbed.experiments.export.identified_run import identified_run
from tulip_testbed.experiments.identify import Identification, warn_of_unrest
from tulip_testbed.experiments.identify import identify as _identify
from tulip_testbed.experiments.imperfections import default_estimator
from tulip_testbed.experiments.laboratory import DEFAULT_SEED, Laboratory, Run
from tulip_testbed.experiments.montecarlo.montecarlo_run import MonteCarlo, Place, montecarlo
from tulip_testbed.experiments.montecarlo.settings import Settings
from tulip_testbed.experiments.planning_run import PlanSettings, optimal_plan
from tulip_testbed.experiments.predict import Prediction
from tulip_testbed.experiments.predict import predict as _predict
from tulip_testbed.experiments.proposed_experiment import Proposals, next_of, write_experiment_plan
from tulip_testbed.experiments.protocols.motion import SPEED
from tulip_testbed.experiments.protocols.protocol_run import (
    REPEATS,
    LaboratoryProtocol,
    ProtocolSettings,
    protocol_of,
)
from tulip_testbed.experiments.records import read_record, record_of
from tulip_testbed.experiments.robot_import.robot_import import import_robot
from tulip_testbed.experiments.table_import.import_map import read_map
from tulip_testbed.experiments.table_import.table_import import ImportedTable
from tulip_testbed.experiments.table_import.table_import import import_table as _import_table
from tulip_testbed.experiments.usable_plan import check_plan
from tulip_testbed.experiments.validate import Validation
from tulip_testbed.experiments.validate import validate as _validate
from tulip_testbed.experiments.watching.watch_day import Arrival, WatchSettings, watch_day
from tulip_testbed.identification.planning.interior_point import SOLVERS
from tulip_testbed.identification.planning.search import HOPS
from tulip_testbed.sim.arguments import checked
from tulip_testbed.sim.errors import InputError, at_least
from tulip_testbed.sim.files import check_new
from tulip_testbed.sim.measurements import Measurements, PosturePlan, joined
from tulip_testbed.sim.measurements import read_measurements as _read_measurements
from tulip_testbed.sim.measurements import write_measurements as _write_measurements
from tulip_testbed.sim.measurements.contract import check_contract
from tulip_testbed.sim.robot import PUBLISHED, Robot
from tulip_testbed.sim.shipped import TULIP
from tulip_testbed.sim.threads import one_blas_thread, processes

__all__ = [
    "InputError",
    "Laboratory",
    "atlas",
    "campaign",
    "check",
    "discover",
    "export_model",
    "identify",
    "import_table",
    "load_robot",
    "monte_carlo",
    "next_experiment",
    "plan",
    "predict",
    "protocol",
    "read_measurements",
    "report",
    "validate",
    "view",
    "watch",
    "write_measurements",
]

Measured = Measurements | Run | str | Path
Several = Measured | Sequence[Measured]
Reported = Run | Validation | Discovered | MonteCarlo | Campaign | str | Path
Viewed = Reported | Measurements | PosturePlan


@checked
def load_robot(path: str | Path = TULIP) -> Robot:
    """Load a robot and check its description and its model against each other.

    Args:
        path: of the description (TOML), or of a published MJCF or URDF, of which a description is made in a
            temporary folder (`tulip robot` writes one to keep); TULip's if left out.

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
def read_measurements(folder: str | Path) -> Measurements:
    """Read and check a measurement folder.

    Raises:
        InputError: the folder breaks the contract; names file, place, what was found and what was expected.
    """
    return _read_measurements(Path(folder))


@checked
def write_measurements(folder: str | Path, measurements: Measurements) -> None:
    """Write a measurement folder, which appears whole or not at all.

    Raises:
        InputError: measurements that no folder can hold; the folder exists or cannot be written.
    """
    _write_measurements(Path(folder), measurements)


@checked
def import_table(
    table: str | Path, folder: str | Path, robot: Robot | None = None, stated: Sequence[str] = ()
) -> ImportedTable:
    """Make a measurement folder of a laboratory's own table, which keeps its names, units and signs.

    Args:
        table: CSV or Parquet, one row a held posture.
        folder: a new one.
        robot: that was measured; TULip if None.
        stated: what the table does not say: the path of a TOML file, and entries such as
            "q.right_knee=RKnee [deg]:deg:-1".

    Returns:
        what was mapped, assumed and is to be decided; its `folder` is None if something necessary is missing.

    Raises:
        InputError: a table or a statement that cannot be read, or a folder that exists.
    """
    return _import_table(Path(table), robot or load_robot(), Path(folder), read_map(stated))


@checked
@one_blas_thread
def identify(
    measurements: Several,
    robot: Robot | None = None,
    estimator: str = SELF_CALIBRATING,
    corrections: Effects = (),
    tolerances: Mapping[str, float] | None = None,
) -> Identification:
    """Identify a robot from what was measured.

    Args:
        measurements: or their folder, or a run; a list of them: experiments with one robot.
        robot: the nominal robot; TULip if None.
        estimator: "self-calibrating", "mixed-model", "least-squares", "placement", "errors-in-variables",
            "robust", "prior" or "consistent".
        corrections: effects that the measurements are corrected for, e.g. `discover(...).adopted`; or texts
            as for `Laboratory.with_effects`.
        tolerances: what is usual for the ordinary imperfections of this laboratory, by family [SI], e.g.
            `{"encoder-offset": 0.001, "link-length": 0}` (0: exact); in place of those of the measurements
            and those that fit the sensors. For the self-calibrating estimator.

    Returns:
        the full model and the simplified one; `fit["torso.x"].value` [m].

    Raises:
        InputError: measurements that do not fit the robot or do not suffice, an unknown estimator, an unknown
            family or an impossible tolerance.
    """
    robot = robot or load_robot()
    adopted = _corrections(corrections, robot)
    given = _measurements(measurements)
    source = _source(measurements)
    found = _identify(given, robot, estimator=estimator, adopted=adopted, tolerances=tolerances)
    for one, where in _to_check(measurements):
        warn_of_faults(one, robot, adopted, where, tolerances)
    warn_of_unrest(found, source or "measurements")
    return found


@checked
@one_blas_thread
def discover(
    measurements: Several,
    robot: Robot | None = None,
    seed: int = 0,
    check: bool = True,
    workers: int | None = None,
    tolerances: Mapping[str, float] | None = None,
) -> Discovered:
    """Find what the nominal model lacks: where it disagrees with measurements, and which effect explains it.

    Args:
        measurements: or their folder, or a run; a list of them: experiments with one robot.
        robot: the nominal robot; TULip if None.
        seed: of the bootstrap that calibrates the level.
        check: simulate adopted physics in the full dynamics, which may take two minutes.
        workers: processes of that simulation; None: one a core. Results do not depend on it.
        tolerances: what is usual for the ordinary imperfections of this laboratory, as in `identify`.

    Returns:
        the verdict "none", "calibrated", "named", "described", "ambiguous" or "unknown"; what was adopted;
        the robot identified before and after.

    Raises:
        InputError: measurements that do not fit the robot, in wrong units, or too few placements; an unknown
            family or an impossible tolerance.
    """
    robot, given = robot or load_robot(), _measurements(measurements)
    found = discover_effects(given, robot, seed, check, processes(workers), tolerances=tolerances)
    for one, where in _to_check(measurements):
        warn_of_faults(one, robot, source=where, tolerances=tolerances)
    return found


@checked
@one_blas_thread
def next_experiment(
    found: Discovered | str | Path,
    robot: Robot | None = None,
    plan: PosturePlan | None = None,
    seed: int = 0,
    out: str | Path | None = None,
) -> Proposals:
    """Rank the experiments that would settle an ambiguous discovery.

    Args:
        found: a discovery, or its run folder.
        robot: that the folder's run was made with; TULip if None.
        plan: postures to choose from; None: those that were measured.
        seed: of the draws of the expectation.
        out: plan folder to write, of the best experiment with its manipulations; None: none.

    Returns:
        the experiments, the best first; `best.plan`, `best.experiment.manipulations`.

    Raises:
        InputError: no discovery; with `out`, nothing to settle, or a folder that exists.
    """
    at_least("seed", seed, 0)
    if out is not None:
        check_new(Path(out))
    if isinstance(found, Discovered):
        ranked = next_of(found, found.robot, plan, seed)
    else:
        robot = robot or load_robot()
        ranked = next_of(read_discovery(Path(found), robot), robot, plan, seed)
    if out is not None:
        write_experiment_plan(Path(out), ranked)
    return ranked


@checked
@one_blas_thread
def campaign(
    laboratory: Laboratory,
    plan: PosturePlan,
    seed: int = DEFAULT_SEED,
    experiments: int = 3,
    minutes: float | None = None,
    engine: str = "statics",
    ordinary: float | None = None,
    folder: str | Path | None = None,
) -> Campaign:
    """Simulate, discover, propose and simulate until one explanation is left or the budget ends.

    Args:
        laboratory: with hidden effects. plan: of the first experiment; later ones choose their postures from
            it.
        seed: of everything random.
        experiments: at most. minutes: of laboratory time at most (assumed times); None: no limit.
        engine: "statics" or "dynamics".
        ordinary: see `validate`.
        folder: keeps the experiments; the same call goes on where one was stopped. None: a temporary one.

    Raises:
        InputError: what cannot be run; a folder that holds something else.
    """
    settings = campaign_settings(seed, engine, experiments, minutes, ordinary)
    return _campaign(laboratory, plan, settings, None if folder is None else Path(folder))


@checked
@one_blas_thread
def validate(
    laboratory: Laboratory,
    plan: PosturePlan,
    seed: int = DEFAULT_SEED,
    estimator: str | None = None,
    engine: str = "dynamics",
    workers: int | None = None,
    ordinary: float | None = None,
) -> Validation:
    """Simulate a plan, identify the robot, compare with the truth and give a verdict.

    Args:
        plan: postures to measure, e.g. `plans.random`.
        seed: of everything random.
        estimator: see `identify`; None: "mixed-model", or "self-calibrating" in an ordinary laboratory.
        engine: "dynamics", half a minute, or "statics", a second.
        workers: processes; None: one a core. Results do not depend on it.
        ordinary: scale of ordinary imperfections of all families that are drawn and hidden in the laboratory,
            1: spreads of 0.1 to 1 tolerance; None: there are none.

    Raises:
        InputError: a plan that does not fit the robot or would not identify it.
    """
    return _validate(laboratory, plan, seed, estimator, engine, workers, ordinary=ordinary)


@checked
@one_blas_thread
def monte_carlo(
    laboratory: Laboratory,
    plan: PosturePlan,
    runs: int,
    seed: int = DEFAULT_SEED,
    estimator: str | None = None,
    random_robots: float | None = None,
    engine: str = "statics",
    workers: int | None = None,
    folder: str | Path | None = None,
    scheduler: str | None = None,
    ordinary: float | None = None,
) -> MonteCarlo:
    """Repeat an experiment with known truth and ask whether the estimator is right about its own errors.

    Args:
        runs: how many.
        estimator: see `validate`.
        random_robots: s.d. of the logarithm of each link's mass, and of its centre of mass in half edges of
            its inertia box: a random true robot in every run; None: the nominal one.
        engine: "statics", or "dynamics": about a minute a run.
        workers: processes; None: one a core. Results do not depend on it.
        folder: keeps the runs; the same call resumes what was stopped. None: a temporary one.
        scheduler: address of a Dask scheduler, "tcp://HOST:PORT"; None: processes of this machine.
        ordinary: see `validate`; every run draws a laboratory of its own.

    Raises:
        InputError: what cannot be run; a folder that holds another Monte Carlo.
    """
    chosen = default_estimator(estimator, ordinary, laboratory)
    settings = Settings(runs, seed, chosen, random_robots, engine, ordinary)
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(scratch) / "runs" if folder is None else Path(folder)
        return montecarlo(
            laboratory, plan, settings, Place(kept, processes(workers), scheduler, folder is not None)
        )


@checked
@one_blas_thread
def plan(
    robot: Robot | None = None,
    seed: int = DEFAULT_SEED,
    objective: str = "condition",
    placements: int = 10,
    postures_per_placement: int = 5,
    after: Measurements | None = None,
    single_support: int = 0,
    repeats: int = 0,
    hops: int = HOPS,
    solver: str = SOLVERS[0],
    right: int = 0,
    left: int = 0,
) -> PosturePlan:
    """Search for optimal postures (section IV): from a random feasible start, under every constraint.

    Args:
        robot: the nominal robot; TULip if None.
        seed: of everything random.
        objective: "condition", "d-optimal", "a-optimal", ...: what is made small.
        placements, postures_per_placement: size of the plan.
        after: what was measured before: the plan tells most next.
        single_support: postures on the right foot alone, after the others.
        repeats: postures that come twice.
        hops: exchanges of a placement's postures; a minute for the default.
        solver: of the last round, "slsqp" or "ipopt".
        right, left: postures on the right and on the left foot alone, optimised together with the others.

    Raises:
        InputError: a setting out of range, or too few postures to identify the robot.
    """
    size = (placements, postures_per_placement, hops)
    if after is not None:
        check_contract(after)
    wanted = PlanSettings(seed, objective, *size, single_support, repeats, solver, right, left)
    return optimal_plan(robot or load_robot(), wanted, after)


@checked
@one_blas_thread
def protocol(
    plan: PosturePlan,
    folder: str | Path,
    robot: Robot | None = None,
    sensors: str | None = None,
    speed: float = SPEED,
    repeats: int = REPEATS,
) -> LaboratoryProtocol:
    """Write what a laboratory needs to carry a plan out: pages to print, trajectories, a measurement folder.

    Args:
        plan: postures to measure.
        folder: a new one.
        robot: the nominal robot; TULip if None.
        sensors: preset whose data sheet starts the measurement folder; None: it is left open.
        speed: largest speed of a joint between postures [rad/s].
        repeats: postures that are measured twice if the plan repeats none; at most every fifth is.

    Returns:
        the plan in the order in which it is measured, with the motion to every posture.

    Raises:
        InputError: a plan that does not fit the robot, a setting out of range, or a folder that exists.
    """
    from tulip_testbed.pages.protocol_page import write_protocol

    check_new(Path(folder))
    made = protocol_of(robot or load_robot(), plan, ProtocolSettings(sensors, speed, repeats))
    write_protocol(Path(folder), made)
    return made


@checked
@one_blas_thread
def check(
    measurements: Measured,
    robot: Robot | None = None,
    corrections: Effects = (),
) -> Preflight:
    """Check measurements for faults: weights, drift, plates, legs, units and more.

    Args:
        measurements: or a run, or their folder, whose complaints about missing columns are listed too.
        robot: the nominal robot; TULip if None.
        corrections: effects that the measurements are corrected for before.

    Raises:
        InputError: no such folder, or another robot's.
    """
    robot = robot or load_robot()
    known = _corrections(corrections, robot)
    if isinstance(measurements, str | Path):
        return check_folder(Path(measurements), robot, known)
    return check_measurements(_measurements(measurements, likely=False), robot, known)


@checked
def watch(
    folder: str | Path,
    plan: PosturePlan,
    robot: Robot | None = None,
    state: str | Path | None = None,
    targets: Mapping[str, float] | None = None,
    follow: bool = True,
    rows: Iterable[bytes] | None = None,
) -> Iterator[Arrival]:
    """Check a day's postures while they are measured, and tell when to stop.

    Args:
        folder: measurement folder whose manifest.json is written and whose postures.csv grows. Nothing is
            written into it.
        plan: postures that are being measured.
        robot: the nominal robot; TULip if None.
        state: file that keeps the state, so that a watch that ended goes on; None: it is not kept.
        targets: standard errors at which to stop, by base parameter or "all" [m].
        follow: wait for more rows until every posture is measured; otherwise judge those that are there.
        rows: lines of a CSV after their header, in place of the folder's postures.csv.

    Returns:
        what came of every row, as soon as it is there; `verdict` says what it shows, which posture is next
        and whether the day may end.

    Raises:
        InputError: another robot's folder or plan, sensors other than plates on four cells, a state of
            another day; while rows arrive, a table whose header changes or that becomes shorter.
    """
    place = None if state is None else Path(state)
    robot = robot or load_robot()
    return watch_day(WatchSettings(Path(folder), plan, robot, place, targets, follow, rows))


@checked
@one_blas_thread
def predict(
    measurements: Measured,
    robot: Robot | None = None,
    train: Sequence[str] = (),
    test: Sequence[str] = (),
) -> Prediction:
    """Ask whether the identified model predicts better than CAD.

    Args:
        measurements: or their folder, or a run.
        robot: the nominal robot, whose masses are CAD's; TULip if None.
        train, test: postures by number, "1-40", or placements, "placement:1-8"; the rest if left out. Without
            both the postures are split by blocks of placements and by halves.

    Returns:
        r.m.s. of the centre of pressure on postures that took no part, for CAD, a constant, the identified
        model and one with a prior at CAD; `beats_cad`.

    Raises:
        InputError: measurements that do not fit the robot, or parts that are not there.
    """
    source = _source(measurements) or "measurements"
    return _predict(_measurements(measurements), robot or load_robot(), train, test, source)


@checked
@one_blas_thread
def export_model(
    found: Identification | Validation | Discovered | str | Path,
    path: str | Path,
    robot: Robot | None = None,
    source: str | Path | None = None,
    samples: int = SAMPLES,
    seed: int = DEFAULT_SEED,
    lengths: bool = False,
) -> ExportedModel:
    """Write the identified robot as a model file for MuJoCo or Pinocchio.

    Base parameters and total mass are the identified ones; what statics cannot see is as near to CAD as
    physical consistency allows. Only the <inertial> elements of the robot's own file change.

    Args:
        found: an identification, a validation or a discovery, or the folder of a validation, a discovery or
            measurements.
        path: of a new file, .xml or .urdf.
        robot: the nominal robot, whose masses are CAD's; TULip if None.
        source: published MJCF or URDF of which the robot was made: its inertias are replaced instead.
        samples: random robots that the measurements allow, written beside the model as NAME-samples.npz.
        seed: of the samples.
        lengths: put the link lengths that a discovery or a folder adopted into the file.

    Returns:
        mass, centre and inertia of every link before and after, how much of each is data, and how far the
        robot is from the estimate.

    Raises:
        InputError: a folder without an estimate, another robot, a file that exists or has another ending, or
            one whose settings overrule its inertias.
    """
    robot = robot or load_robot()
    weighed, adopted = None, ()
    if isinstance(found, str | Path):
        found, measurements, adopted = identified_run(Path(found), robot)
        weighed = measurements.weighed_mass
    elif isinstance(found, Validation):
        adopted = found.run.laboratory.known
        weighed, found = found.run.measurements.weighed_mass, found.identification
    elif isinstance(found, Discovered):
        adopted = found.discovery.corrections
        weighed, found = found.discovery.observed.measurements.weighed_mass, found.after or found.before
    place = None if source is None else Path(source)
    return _export_model(found, robot, Export(Path(path), place, samples, seed, adopted, lengths), weighed)


def _corrections(corrections: Effects, robot: Robot) -> tuple[EffectInstance, ...]:
    found = instances_of(corrections, robot, "corrections")
    check_different(found, "corrections")
    return found


def _each(measurements: Several) -> list[Measured]:
    single = isinstance(measurements, Measurements | Run | str | Path)
    return [measurements] if single else list(measurements)  # pyrefly: ignore[bad-argument-type]


def _source(measurements: Several) -> str | None:
    """Return the folders of measurements, for messages."""
    folders = [str(one) for one in _each(measurements) if isinstance(one, str | Path)]
    return ", ".join(folders) or None


def _to_check(measurements: Several) -> list[tuple[Measurements, str | None]]:
    """Return each experiment with its source, but those that were simulated with faults on purpose."""
    return [(_measurements(one), _source(one)) for one in _each(measurements) if not isinstance(one, Run)]


def _measurements(measured: Several, likely: bool = True) -> Measurements:
    """Return measurements, or those of runs and folders, held against the contract once and joined."""
    each, found = _each(measured), []
    for one in each:
        if isinstance(one, str | Path):
            found.append(read_measurements(one))
            continue
        found.append(one.measurements if isinstance(one, Run) else one)
        check_contract(found[-1], likely=likely)
    names = [str(one) if isinstance(one, str | Path) else f"experiment {k + 1}" for k, one in enumerate(each)]
    return joined(found, names)


@checked
@one_blas_thread
def atlas(
    plan: PosturePlan, robot: Robot | None = None, sensors: str = "wii", seed: int = DEFAULT_SEED
) -> Atlas:
    """Tell before any data which effects a plan would show, confuse or hide.

    Args:
        robot: the nominal robot; TULip if None.
        sensors: "wii" or "force-plate".
        seed: of the simulated noise.

    Raises:
        InputError: a plan that would not identify the robot, or that statics does not know.
    """
    robot = robot or load_robot()
    check_plan(robot, plan)
    return _atlas(planned(plan, sensors, robot, seed), np.random.default_rng(seed))


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
        made = measurements_view(_measurements(shown), robot)
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
        shown: a run, which is identified and held against its truth; a validation, a discovery, a Monte
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
