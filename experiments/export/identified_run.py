"""The identification that a folder holds."""

from pathlib import Path

from tulip_testbed.base.errors import InputError, warn
from tulip_testbed.discovery.discover import AMBIGUOUS, UNKNOWN
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.check_folder import warn_of_faults
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.identify import identify, warn_of_unrest
from tulip_testbed.experiments.run_file import kind_of
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import read_measurements
from tulip_testbed.sim.robot import Robot


def identified_run(
    run: Validation | Discovered | str | Path, robot: Robot
) -> tuple[Identification, tuple[EffectInstance, ...]]:
    """Return the identification that a run or its folder holds.

    Args:
        run: a validation; a discovery, whose adopted effects are removed; or the folder of either, or of
            measurements, which are identified by the default estimator.

    Returns:
        the identification, and what the run adds to the nominal laboratory: effects and calibrated
        imperfections.

    Raises:
        InputError: a folder without an estimate, of another robot, or that was changed.
    """
    if isinstance(run, Validation):
        return run.identification, run.identification.corrections
    if isinstance(run, Discovered):
        return run.after or run.before, run.corrections
    folder = Path(run)
    kind = kind_of(folder)
    if kind == "validation":
        return identified_run(Validation.load(folder, robot), robot)
    if kind == "discovery":
        discovery = Discovered.load(folder, robot)
        if discovery.verdict in (AMBIGUOUS, UNKNOWN):
            warn(
                f"{folder}: found the verdict {discovery.verdict}: nothing was adopted, so the robot keeps "
                "the bias of what the model lacks"
            )
        return identified_run(discovery, robot)
    if kind == "measurement":
        measured = read_measurements(folder)
        warn_of_faults(measured, robot, source=str(folder))
        found = identify(measured, robot, str(folder))
        warn_of_unrest(found, str(folder))
        return found, ()
    raise InputError(
        f"{folder}: found a {kind} folder, which holds no estimate of one robot; expected the folder of "
        "a validation, a discovery or measurements"
    )
