"""Functions of a virtual laboratory: simulate, validate and Monte Carlo."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from tulip_testbed.base.arguments import checked
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.threads import one_blas_thread, processes
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR, DEFAULT_SEED, ORDINARY
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, Settings
from tulip_testbed.experiments.montecarlo.montecarlo_run import montecarlo
from tulip_testbed.experiments.simulate import Simulation
from tulip_testbed.experiments.simulate import simulate as _simulate
from tulip_testbed.experiments.validate import validate as _validate
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import PosturePlan

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
    made = Path(plan) if isinstance(plan, str) else plan
    file, proposed = (None if one is None else Path(one) for one in (truth, experiment))
    how = (imperfections, robot_spread, proposed, session, engine, workers, progress)
    return _simulate(laboratory, made, Path(out), seed, file, effects, *how)


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
    return _validate(
        laboratory, plan, seed, estimator, engine, workers, progress, imperfections, robot_spread
    )


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
