"""The identification that a folder holds."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.base.errors import InputError, warn
from tulip_testbed.discovery.discover import AMBIGUOUS, UNKNOWN
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.run_file import kind_of
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.measurements import Measurements, read_experiments
from tulip_testbed.sim.robot import Robot


def identified_run(
    folder: Path, robot: Robot
) -> tuple[Identification, Measurements, tuple[EffectInstance, ...]]:
    """Identify the robot of a folder as the folder did.

    Args:
        folder: of a validation, which names its estimator; of a discovery, whose adopted effects are removed;
            or of measurements, for the default estimator.

    Returns:
        the identification, its measurements, and what the folder adds to the nominal laboratory: effects and
        calibrated imperfections.

    Raises:
        InputError: a folder without an estimate, of another robot, or that was changed.
    """
    folder = Path(folder)
    kind = kind_of(folder)
    if kind == "validation":
        judged = Validation.load(folder, robot).identification
        return judged, judged.measurements, judged.corrections
    if kind == "discovery":
        discovery = Discovered.load(folder, robot)
        if discovery.verdict in (AMBIGUOUS, UNKNOWN):
            warn(
                f"{folder}: found the verdict {discovery.verdict}: nothing was adopted, so the robot keeps "
                "the bias of what the model lacks"
            )
        return discovery.after or discovery.before, discovery.measurements, discovery.corrections
    if kind == "measurement":
        measurements = read_experiments([folder])
        return identify(measurements, robot, str(folder)), measurements, ()
    raise InputError(
        f"{folder}: found a {kind} folder, which holds no estimate of one robot; expected the folder of "
        "a validation, a discovery or measurements"
    )
