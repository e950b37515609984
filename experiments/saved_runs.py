"""Runs of any kind, read from their folders, and the identification that one holds."""

from pathlib import Path

from tulip_testbed.base.errors import InputError, warn
from tulip_testbed.discovery.discover import AMBIGUOUS, UNKNOWN
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.check_folder import warn_of_faults
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.identify import identify, warn_of_unrest
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.run_file import kind_of, run_kind
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import read_measurements
from tulip_testbed.sim.robot import Robot

RunResult = Validation | Discovered | MonteCarlo


def read_run(folder: Path, robot: Robot) -> RunResult:
    """Read a run folder of any kind and check that nothing in it was changed."""
    kinds = {one.kind: one for one in (Validation, Discovered, MonteCarlo)}
    return kinds[run_kind(folder)].load(folder, robot)


def identified_run(
    run: Validation | Discovered | str | Path, robot: Robot
) -> tuple[Identification, tuple[EffectInstance, ...]]:
    """Return the identification of a run or its folder, and what the run adds to the nominal laboratory.

    Of a discovery it is that with the adopted effects removed; measurements are identified by the default
    estimator.

    Raises:
        InputError: a folder without an estimate, of another robot, or that was changed.
    """
    if isinstance(run, str | Path):
        folder = Path(run)
        if (kind := kind_of(folder)) == "measurement":
            measured = read_measurements(folder)
            warn_of_faults(measured, robot, source=str(folder))
            found = identify(measured, robot, str(folder))
            warn_of_unrest(found, str(folder))
            return found, ()
        if kind not in (Validation.kind, Discovered.kind):
            raise InputError(
                f"{folder}: found a {kind} folder, which holds no estimate of one robot; expected the folder "
                "of a validation, a discovery or measurements"
            )
        run = (Validation if kind == Validation.kind else Discovered).load(folder, robot)
        if isinstance(run, Discovered) and run.verdict in (AMBIGUOUS, UNKNOWN):
            warn(
                f"{folder}: found the verdict {run.verdict}: nothing was adopted, so the robot keeps the "
                "bias of what the model lacks"
            )
    if isinstance(run, Validation):
        return run.identification, run.identification.corrections
    return run.after or run.before, run.corrections
