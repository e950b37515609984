"""Functions of a virtual laboratory: simulate, validate and Monte Carlo."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tulip_testbed.api.inputs import plan_of
from tulip_testbed.base.arguments import checked
from tulip_testbed.base.errors import InputError, at_least, look_up
from tulip_testbed.base.files import present
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.threads import one_blas_thread, processes
from tulip_testbed.effects.random_effects import RANDOM
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR, DEFAULT_SEED, ORDINARY
from tulip_testbed.experiments.identification_result import ESTIMATORS
from tulip_testbed.experiments.imperfections import check_imperfections, drawn, single_stream
from tulip_testbed.experiments.laboratory import Laboratory, tries
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, Settings
from tulip_testbed.experiments.montecarlo.montecarlo_run import montecarlo
from tulip_testbed.experiments.proposed_experiment import EXPERIMENT_FILE, read_experiment
from tulip_testbed.experiments.simulate import (
    DroppedPosture,
    Simulation,
    check_places,
    disturbed,
    write_experiment,
)
from tulip_testbed.experiments.usable_plan import identifiable_regressor
from tulip_testbed.experiments.validate import judge
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.trajectory import runs

PlainLaboratory = Laboratory  # in which the function hides effects itself: the command line adds none

Planned = PosturePlan | str | Path | None


@checked
@one_blas_thread
def simulate(
    laboratory: PlainLaboratory,
    plan: Planned = None,
    *,
    out: str | Path,
    seed: int = DEFAULT_SEED,
    truth: str | Path | None = None,
    effects: Sequence[str] = (),
    imperfections: float = 0.0,
    robot_spread: float | None = None,
    experiment: str | Path | None = None,
    session: str | None = None,
    engine: str = "dynamics",
    workers: int | None = None,
    progress: Progress = silent,
) -> Simulation:
    """Simulate an experiment and write a measurement folder.

    The folder does not contain the truth, which can be written to another file. Only that file names a
    random effect and the imperfections. `Laboratory.run` does the same in memory.

    Args:
        plan: postures to measure, their folder, or the name of a shipped plan; None: the shipped one.
        out: new measurement folder.
        seed: of everything random.
        truth: new file for the truth.
        effects: physical effects to hide, NAME[:TARGET]=VALUE[,VALUE] in SI units, or "random" for one that
            is not told.
        imperfections: scale of ordinary imperfections of all families, which are drawn and hidden in the
            laboratory; 1: spreads of 0.1 to 1 tolerance; 0: an exact laboratory.
        robot_spread: s.d. of the logarithm of each link's mass, and of its centre of mass in half edges of
            its inertia box: a random true robot, the seed's; None: the nominal one.
        experiment: plan folder of a proposed experiment: its postures after its manipulations.
        session: name of the session; its experiments share tares, floor and survey.
        engine: "dynamics", half a minute, or "statics", a second.
        workers: processes; None: one per core. Results do not depend on it.
        progress: shows how far the work is.

    Raises:
        InputError: what cannot be simulated, or a place that cannot be written.
    """
    place = Path(out)
    file, proposed = (None if one is None else Path(one) for one in (truth, experiment))
    check_places(place, file)
    secret = RANDOM in effects
    if secret and file is None:
        raise InputError(
            "effects random: found no file for the truth, expected `truth=FILE`: nothing else would know it"
        )
    wanted, number = (None, 1) if proposed is None else read_experiment(proposed)
    if proposed is not None and plan is not None:
        raise InputError("experiment: found a plan besides, expected the plan of its own folder")
    if isinstance(plan, str | Path) and present(Path(plan) / EXPERIMENT_FILE):
        raise InputError(
            f"{plan}: found {EXPERIMENT_FILE}, expected it as `experiment={plan}`: a plain plan would leave "
            "its manipulations out"
        )
    made = plan if isinstance(plan, PosturePlan) else plan_of(plan or proposed, laboratory.robot)
    laboratory = disturbed(laboratory, made, effects, seed, engine == "statics")
    check_imperfections(laboratory, imperfections)
    if robot_spread is not None:
        laboratory = replace(laboratory, random_robot=(robot_spread, seed))
    laboratory = drawn(laboratory, imperfections, single_stream(seed))
    if wanted is not None or session is not None:
        texts = () if wanted is None else wanted.manipulations
        there = "" if wanted is None else wanted.session
        laboratory = laboratory.manipulated(*texts, session=there if session is None else session)
    # The laboratory is that of the seed; its noise differs from experiment to experiment.
    noise = seed if number == 1 else int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    try:
        with progress("holding postures", tries(laboratory, made), 0) as advance:
            run = laboratory.run(made, noise, engine, workers, advance)
    except InputError:
        if not secret:
            raise
        raise InputError(
            "effects random: found an experiment that cannot be carried out with the effect that seed "
            f"{seed} draws, expected one that can; give another seed"
        ) from None
    write_experiment(place, file, run)
    dropped = tuple(DroppedPosture(number, None if secret else why) for number, why in run.truth.dropped)
    made_of = (str(place), run.plan.postures, len(run.measurements), dropped)
    if run.samples is None:
        return Simulation(*made_of)
    segments = runs(run.samples.posture)
    return Simulation(*made_of, len(segments), sum(float(np.ptp(run.samples.time[s])) for s in segments))


@checked
@one_blas_thread
def validate(
    laboratory: Laboratory,
    plan: PosturePlan,
    *,
    seed: int = DEFAULT_SEED,
    estimator: str = DEFAULT_ESTIMATOR,
    engine: str = "dynamics",
    workers: int | None = None,
    imperfections: float = ORDINARY,
    robot_spread: float | None = None,
    progress: Progress = silent,
) -> Validation:
    """Simulate a plan, identify the robot and compare with the truth.

    The measurements are corrected for the effects that the laboratory is known to have. The laboratory is a
    little wrong in every ordinary way, unless its imperfections are 0. The verdict is "fail" if a check
    fails.

    Args:
        plan: postures to measure, e.g. `plans.random`.
        seed: of everything random.
        estimator: "self-calibrating", "mixed-model", "least-squares", "placement", "errors-in-variables",
            "robust", "prior" or "consistent".
        engine: "dynamics", half a minute, or "statics", a second.
        workers: processes; None: one per core. Results do not depend on it.
        imperfections: scale of ordinary imperfections of all families, which are drawn and hidden in the
            laboratory; 1: spreads of 0.1 to 1 tolerance; 0: an exact laboratory.
        robot_spread: of a random true robot, as in `simulate`; None: the nominal one.
        progress: shows how far the work is.

    Raises:
        InputError: a plan that does not fit the robot or would not identify it.
    """
    began = time.perf_counter()
    look_up("estimator", estimator, ESTIMATORS, "estimator")
    check_imperfections(laboratory, imperfections)
    at_least("seed", seed, 0)
    if robot_spread is not None:
        laboratory = replace(laboratory, random_robot=(robot_spread, seed))
    laboratory.check(plan, engine)
    identifiable_regressor("plan", laboratory.robot, plan)
    laboratory = drawn(laboratory, imperfections, single_stream(seed))
    with progress("holding postures", tries(laboratory, plan), 0) as advance:
        run = laboratory.run(plan, seed, engine, workers, advance)
    return replace(judge(run, estimator, imperfections), wall_s=time.perf_counter() - began)


@checked
@one_blas_thread
def monte_carlo(
    laboratory: Laboratory,
    plan: PosturePlan,
    *,
    runs: int,
    seed: int = DEFAULT_SEED,
    estimator: str = DEFAULT_ESTIMATOR,
    robot_spread: float | None = None,
    engine: str = "statics",
    workers: int | None = None,
    out: str | Path | None = None,
    imperfections: float = ORDINARY,
    progress: Progress = silent,
) -> MonteCarlo:
    """Repeat a simulated experiment and test the stated standard errors.

    The measurements are corrected for the effects that the laboratory is known to have. Every run draws a
    laboratory that is a little wrong in every ordinary way, unless its imperfections are 0. The same call
    resumes runs that were stopped, and reports again on finished ones. The verdict is "fail" if a check
    fails.

    Args:
        runs: how many.
        seed: of everything random.
        estimator: "self-calibrating", "mixed-model", "least-squares", "placement", "errors-in-variables",
            "robust", "prior" or "consistent".
        robot_spread: s.d. of the logarithm of each link's mass, and of its centre of mass in half edges of
            its inertia box: a random true robot in every run; None: the nominal one.
        engine: "statics", or "dynamics": about a minute a run.
        workers: processes; None: one per core. Results do not depend on it.
        out: run folder, new or with a part of these runs; None: a temporary one.
        imperfections: scale of ordinary imperfections of all families, which are drawn and hidden in the
            laboratory of each run; 1: spreads of 0.1 to 1 tolerance; 0: an exact laboratory.
        progress: shows how far the work is.

    Raises:
        InputError: what cannot be run; a folder that holds another Monte Carlo.
    """
    settings = Settings(runs, seed, estimator, robot_spread, engine, imperfections)
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(scratch) / "runs" if out is None else Path(out)
        return montecarlo(laboratory, plan, settings, kept, processes(workers), out is not None, progress)
