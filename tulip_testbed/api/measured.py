"""Functions of a measured robot: check, identify, discover, propose, predict, export."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tulip_testbed.api.inputs import (
    Measured,
    Several,
    corrections_of,
    load_robot,
    measurements_of,
    new_place,
    plan_of,
    source_of,
)
from tulip_testbed.base.arguments import checked
from tulip_testbed.base.errors import at_least
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.threads import one_blas_thread, processes
from tulip_testbed.effects.instance import Effects
from tulip_testbed.experiments.check_folder import Preflight, check_folder, check_measurements
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR
from tulip_testbed.experiments.discovering import discover_effects
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.export.export_model import check_model_file
from tulip_testbed.experiments.export.export_model import export_model as _export_model
from tulip_testbed.experiments.export.exported_model import ExportedModel
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.identify import identify as _identify
from tulip_testbed.experiments.identify import warn_of_contradiction, warn_of_unrest
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.predict import Prediction
from tulip_testbed.experiments.predict import predict as _predict
from tulip_testbed.experiments.proposed_experiment import Proposals
from tulip_testbed.experiments.saved_runs import identified_run
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot

Exportable = Identification | Validation | Discovered | str | Path
Proposable = Discovered | str | Path


@checked
@one_blas_thread
def check(measurements: Measured, robot: Robot | None = None, *, corrections: Effects = ()) -> Preflight:
    """Check measurements for faults.

    Weights, drift, plates, legs, units and more are checked. If a folder is incomplete, the missing parts are
    listed with an example to copy.

    Args:
        measurements: or a run, or their folder.
        robot: the nominal robot; TULip if None.
        corrections: effects that the measurements are corrected for before.

    Raises:
        InputError: no such folder, or another robot's.
    """
    robot = robot or load_robot()
    known = corrections_of(corrections, robot)
    if isinstance(measurements, str | Path):
        return check_folder(Path(measurements), robot, known)
    samples = measurements.samples if isinstance(measurements, Run) else None
    return check_measurements(measurements_of(measurements, likely=False), robot, known, samples=samples)


@checked
@one_blas_thread
def identify(
    measurements: Several,
    robot: Robot | None = None,
    *,
    estimator: str = DEFAULT_ESTIMATOR,
    corrections: Effects = (),
    tolerances: Mapping[str, float] | None = None,
) -> Identification:
    """Identify the robot's base parameters from what was measured.

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
    adopted = corrections_of(corrections, robot)
    given = measurements_of(measurements, robot, adopted, tolerances)
    source = source_of(measurements) or "measurements"
    found = _identify(given, robot, source, estimator, adopted=adopted, tolerances=tolerances)
    warn_of_unrest(found, source)
    warn_of_contradiction(found, source, tolerances)
    return found


@checked
@one_blas_thread
def discover(
    measurements: Several,
    robot: Robot | None = None,
    *,
    seed: int = 0,
    check: bool = True,
    workers: int | None = None,
    tolerances: Mapping[str, float] | None = None,
    anyway: bool = False,
    out: str | Path | None = None,
    progress: Progress = silent,
) -> Discovered:
    """Find physical effects that the model lacks.

    The result tells where the model disagrees with the measurements and which effect explains it. The verdict
    is `none`, `calibrated` (ordinary imperfections explain it), `named`, `described` (by a law composed of
    what errs, as a function of what, in which shape), `ambiguous` or `unknown`. The effects found are added
    to the model: the folder `rig` in the run folder can be given to other commands as corrections.

    The preflight comes first: gross faults, such as a joint's wrong sign, are named, and nothing is searched.
    A search that exceeds its budget ends as `unknown` with the best so far. Up to 2,000 rows it has 10 min of
    processor time and 2 GB of memory; at 10,000 rows, 50 min and 4 GB.

    Args:
        measurements: or their folder, or a run; a list of them: experiments with one robot.
        robot: the nominal robot; TULip if None.
        seed: of the bootstrap that calibrates the level.
        check: simulate adopted physics in the full dynamics, which may take two minutes; faults of
            instruments are never simulated, because they are predicted exactly.
        workers: processes of that simulation; None: one per core. Results do not depend on it.
        tolerances: what is usual for the ordinary imperfections of this laboratory, as in `identify`.
        anyway: search in spite of gross faults.
        out: new run folder.

    Returns:
        the verdict; what was adopted; the robot identified before and after.

    Raises:
        InputError: measurements that do not fit the robot, in wrong units, or too few placements; an unknown
            family or an impossible tolerance; a folder that exists; gross faults.
    """
    robot, place = robot or load_robot(), new_place(out)
    refuse = "" if anyway else "search `anyway`"
    given = measurements_of(measurements, robot, tolerances=tolerances, refuse=refuse)
    source = source_of(measurements) or "measurements"
    result = discover_effects(
        given, robot, seed, check, processes(workers), source, tolerances=tolerances, progress=progress
    )
    if place is None:
        return result
    result = replace(result, folder=place)
    result.save(place)
    return result


@checked
@one_blas_thread
def next_experiment(
    found: Proposable,
    robot: Robot | None = None,
    *,
    plan: PosturePlan | str | Path | None = None,
    seed: int = 0,
) -> Proposals:
    """Rank experiments that would settle an ambiguous discovery.

    Experiments are manipulations of the laboratory and a choice of postures; they are ranked by the doubt
    that each is expected to settle per minute. The best can be saved as a plan folder with its manipulations
    as numbered steps (steps.md), which a simulation carries out.

    Args:
        found: a discovery, or its run folder.
        robot: that the folder's run was made with; TULip if None.
        plan: postures to choose from, or their folder, or a shipped plan's name; None: those that were
            measured.
        seed: of the draws of the expectation.

    Returns:
        the experiments, the best first; `best.plan`, `best.experiment.manipulations`.

    Raises:
        InputError: no discovery.
    """
    at_least("seed", seed, 0)
    robot = robot or load_robot()
    discovery = found if isinstance(found, Discovered) else Discovered.load(found, robot)
    return discovery.propose(None if plan is None else plan_of(plan, robot), seed)


@checked
@one_blas_thread
def predict(
    measurements: Measured,
    robot: Robot | None = None,
    *,
    train: Sequence[str] = (),
    test: Sequence[str] = (),
    corrections: Effects = (),
    exported: str | Path | None = None,
    progress: Progress = silent,
) -> Prediction:
    """Ask whether the identified model predicts better than CAD.

    Models are the robot's own masses (CAD), CAD with an offset, a constant, identified masses, and those with
    corrections. Each predicts the centre of pressure of postures that took no part in its training.

    Args:
        measurements: or their folder, or a run.
        robot: the nominal robot, whose masses are CAD's; TULip if None.
        train, test: postures by number, "1-40", or placements, "placement:1-8"; the rest if left out. Without
            both the postures are split by blocks of placements and by halves.
        corrections: effects of the model with corrections, e.g. `discover(...).adopted`, or texts as for
            `Laboratory.with_effects`; their sizes are fitted in training, next to ordinary imperfections.
        exported: MJCF that was exported from other measurements of this robot, to be scored as well.
        progress: shows how far the work is.

    Returns:
        r.m.s. of the centre of pressure on postures that took no part, for each model; `beats_cad` and
        `beats_cad_with_offset`.

    Raises:
        InputError: measurements that do not fit the robot, or parts that are not there.
    """
    source = source_of(measurements) or "measurements"
    robot = robot or load_robot()
    adopted = corrections_of(corrections, robot)
    file = None if exported is None else Path(exported)
    measured = measurements_of(measurements, robot, adopted)
    return _predict(measured, robot, train, test, source, adopted, file, progress)


@checked
@one_blas_thread
def export_model(
    run: Exportable, robot: Robot | None = None, *, out: str | Path, source: str | Path | None = None
) -> ExportedModel:
    """Write the identified robot as a model file (MJCF or URDF).

    Base parameters and total mass are the identified ones, combined with CAD's by their standard errors; what
    statics cannot see is as near to CAD as physical consistency allows. Only the <inertial> elements of the
    robot's own file change.

    Args:
        run: an identification, a validation or a discovery, or the folder of a validation, a discovery or
            measurements.
        robot: the nominal robot, whose masses are CAD's; TULip if None.
        out: new model file, .xml or .urdf.
        source: published MJCF or URDF of which the robot was made: its inertias are replaced instead.

    Returns:
        mass, centre and inertia of every link before and after, how much of each is data, and how far the
        robot is from the estimate.

    Raises:
        InputError: a folder without an estimate, another robot, a file that exists or has another ending, or
            one whose settings overrule its inertias.
    """
    robot, file = robot or load_robot(), Path(out)
    place = None if source is None else Path(source)
    check_model_file(file, place)  # before a robot is identified
    found, adopted = (run, run.corrections) if isinstance(run, Identification) else identified_run(run, robot)
    return _export_model(found, robot, file, place, adopted, found.measurements.weighed_mass)
