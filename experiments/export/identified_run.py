"""The identification that a folder holds, made again with its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tulip_testbed.base.errors import InputError, warn
from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING
from tulip_testbed.discovery.discover import AMBIGUOUS, UNKNOWN
from tulip_testbed.effects.instance import EffectDocument, EffectInstance
from tulip_testbed.experiments.discovery_record import read_discovery
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.rig_folder import RIG, read_rig
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
        identification = Validation.load(folder, robot).identification
        return identification, identification.measurements, identification.corrections
    if kind == "discovery":
        found = read_discovery(folder, robot)
        effects = _effects(found.report.effects, robot, folder)
        measurements = found.measurements
        adopted = read_rig(folder / RIG, robot) if found.rig else ()
        verdict = found.report.verdict
        if verdict in (AMBIGUOUS, UNKNOWN):
            warn(
                f"{folder}: found the verdict {verdict}: nothing was adopted, so the robot keeps the "
                "bias of what the model lacks"
            )
        estimator = SELF_CALIBRATING
    elif kind == "measurement":
        measurements, estimator = read_experiments([folder]), SELF_CALIBRATING
        effects = adopted = ()
    else:
        raise InputError(
            f"{folder}: found a {kind} folder, which holds no estimate of one robot; expected the folder of "
            "a validation, a discovery or measurements"
        )
    return identify(measurements, robot, str(folder), estimator, adopted=effects), measurements, adopted


def _effects(documents: Sequence[EffectDocument], robot: Robot, folder: Path) -> tuple[EffectInstance, ...]:
    return tuple(EffectInstance.from_document(one, robot, str(folder)) for one in documents)
