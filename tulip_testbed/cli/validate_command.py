"""`tulip validate`."""

from __future__ import annotations

from tulip_testbed.cli.options import (
    CORES,
    DEFAULT_ESTIMATOR,
    DEFAULT_SEED,
    ORDINARY,
    EstimatorName,
    Imperfections,
    Json,
    Plan,
    RigFolder,
    RobotFile,
    RunFolder,
    Seed,
    Sensors,
    Workers,
)
from tulip_testbed.sim.shipped import TULIP


def validate_command(
    plan: Plan = None,
    /,
    *,
    out: RunFolder,
    preset: Sensors = "wii",
    seed: Seed = DEFAULT_SEED,
    workers: Workers = CORES,
    estimator: EstimatorName = DEFAULT_ESTIMATOR,
    imperfections: Imperfections = ORDINARY,
    rig: RigFolder = None,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Simulate a plan, identify the robot and compare with the truth.

    With --rig RIG the laboratory has the rig's effects, and the measurements are corrected for them.
    The laboratory is a little wrong in every ordinary way; with --imperfections 0 it is exact.
    Exit code 0: every check passed; 1: a check failed; 2: could not run.

    Example: tulip validate --out runs/first

    Example: tulip validate --out runs/exact --imperfections 0
    """
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.laboratory_options import laboratory_and_plan
    from tulip_testbed.cli.terminal import print_json, progress, say, show, show_verdict
    from tulip_testbed.experiments.laboratory import tries
    from tulip_testbed.experiments.validate import validate
    from tulip_testbed.experiments.validation_record import validation_record, write_validation
    from tulip_testbed.experiments.validation_tables import validation_report

    check_new(out)
    laboratory, made = laboratory_and_plan(robot, preset, plan, rig)
    with progress("holding postures", tries(laboratory, made)) as advance:
        result = validate(
            laboratory,
            made,
            seed,
            estimator,
            workers=workers,
            progress=advance,
            imperfections=imperfections,
        )
    record = write_validation(out, validation_record(result))
    document = record.report.plain()
    if as_json:
        print_json(document)
    else:
        show(*validation_report(result, document))
        show_verdict(result.verdict, f" after {result.wall_s:.0f} s")
    say(f"Run folder: {out}")
    return 0 if result.verdict == "pass" else 1
