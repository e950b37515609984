"""`tulip validate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
from tulip_testbed.cli.terminal import print_json, progress, say, show, show_verdict
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table
from tulip_testbed.experiments.laboratory import DEFAULT_SEED, tries
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    mass_line,
    models,
    parameter_table,
    read_reported,
)
from tulip_testbed.experiments.run_summary import balance_line, sag_line, usable_postures
from tulip_testbed.experiments.validate import Validation, validate
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
        _show(result, document)
    say(f"Run folder: {out}")
    return 0 if result.verdict == "pass" else 1


def _show(result: Validation, document: dict[str, Any]) -> None:
    run, parameters = result.run, result.identification.parameters
    robot, angles = run.laboratory.robot, run.measurements.joint_angles
    for model in models(robot):
        pairs = document[model]["correlations"]
        show(parameter_table(model, document[model], parameters, read_reported(robot)))
        show(correlation_table(model, pairs, parameters, angles) if pairs else NO_CORRELATION, "")
    mass = document["total_mass"]
    show(LEGEND, *usable_postures(run, robot.settings.get("paper", {})))
    show(mass_line(mass["estimate"], mass["standard_error"], mass["truth"]))
    if document["books"] is not None:
        show(sag_line(run.truth), balance_line(document["books"]))
    show("", result.table())
    show_verdict(result.verdict, f" after {result.wall_s:.0f} s")
