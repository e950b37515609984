"""`tulip validate`."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.cli.laboratory_options import laboratory_and_plan
from tulip_testbed.cli.options import (
    CORES,
    EstimatorName,
    Json,
    Plan,
    Preset,
    RigFolder,
    RobotFile,
    Seed,
    Workers,
)
from tulip_testbed.experiments.laboratory import DEFAULT_SEED, tries
from tulip_testbed.experiments.parameter_tables import (
    print_validation,
)
from tulip_testbed.experiments.terminal import ERR, console, print_json, progress
from tulip_testbed.experiments.validate import validate
from tulip_testbed.experiments.validation_record import validation_record, write_validation
from tulip_testbed.identification.estimators import DEFAULT, ESTIMATORS
from tulip_testbed.sim.errors import at_least, look_up
from tulip_testbed.sim.files import check_new
from tulip_testbed.sim.robot import TULIP


def validate_command(
    plan: Plan = None,
    /,
    *,
    out: Path,
    preset: Preset = "wii",
    seed: Seed = DEFAULT_SEED,
    workers: Workers = CORES,
    estimator: EstimatorName = DEFAULT,
    rig: RigFolder = None,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Simulate a plan, identify the robot, compare with the truth and give a verdict.

    With --rig RIG the laboratory has the rig's effects, and the measurements are freed of them.
    Exit code 0: every check passed; 1: a check failed; 2: could not run.
    Example: tulip validate --out runs/first
    """
    check_new(out)
    look_up("estimator", estimator, ESTIMATORS, "estimator")
    at_least("seed", seed, 0)
    at_least("workers", workers, 1)
    laboratory, made = laboratory_and_plan(robot, preset, plan, rig)
    with progress("holding postures", tries(laboratory, made)) as advance:
        result = validate(laboratory, made, seed, estimator, workers=workers, progress=advance)
    record = write_validation(out, validation_record(result))
    document = record.report.plain()
    if as_json:
        print_json(document)
    else:
        print_validation(console(), result, document)
    ERR.print(f"Run folder: {out}")
    return 0 if result.verdict == "pass" else 1
