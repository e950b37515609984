"""`tulip montecarlo`."""

from __future__ import annotations

from typing import Annotated

import tyro

from tulip_testbed.cli.options import (
    CORES,
    DEFAULT_ESTIMATOR,
    DEFAULT_SEED,
    ORDINARY,
    Address,
    EngineName,
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

Spread = Annotated[
    float | None,
    tyro.conf.arg(
        metavar="SPREAD",
        help="a random true robot in every run: s.d. of the logarithm of each link's mass, and of its "
        "centre of mass in half edges of its inertia box",
    ),
]
Dynamics = Annotated[bool, tyro.conf.arg(help="simulate every run in the full dynamics, about a minute each")]


def montecarlo_command(
    plan: Plan = None,
    /,
    *,
    out: RunFolder,
    runs: int,
    preset: Sensors = "wii",
    estimator: EstimatorName = DEFAULT_ESTIMATOR,
    imperfections: Imperfections = ORDINARY,
    rig: RigFolder = None,
    engine: EngineName = "loky",
    address: Address = None,
    workers: Workers = CORES,
    seed: Seed = DEFAULT_SEED,
    robot_spread: Spread = None,
    dynamics: Dynamics = False,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Repeat a simulated experiment and test the stated standard errors.

    With --rig RIG the laboratory has the rig's effects, and the measurements are corrected for them.
    Every run draws a laboratory that is a little wrong in every ordinary way; with --imperfections 0 it is
    exact.
    The same command resumes a run that was stopped, and reports again on a finished one.
    Exit code 0: every check passed; 1: a check failed; 2: could not run; 130: interrupted.

    Example: tulip montecarlo --out runs/calibration --runs 1000

    Example: tulip montecarlo --out runs/exact --runs 200 --imperfections 0
    """
    import time

    from tulip_testbed.cli.laboratory_options import laboratory_and_plan
    from tulip_testbed.cli.terminal import print_json, progress, say, show, show_verdict
    from tulip_testbed.experiments.montecarlo.calibration_tables import TOO_FEW, calibration_report
    from tulip_testbed.experiments.montecarlo.engine import check_engine
    from tulip_testbed.experiments.montecarlo.montecarlo_run import Interrupted, Place, montecarlo
    from tulip_testbed.experiments.montecarlo.settings import Settings

    began = time.perf_counter()
    check_engine(engine, address)
    laboratory, made = laboratory_and_plan(robot, preset, plan, rig)
    where = "dynamics" if dynamics else "statics"
    settings = Settings(runs, seed, estimator, robot_spread, where, imperfections)
    try:
        report = montecarlo(laboratory, made, settings, Place(out, workers, address), progress).report.plain()
    except Interrupted as stopped:
        say(f"tulip: {stopped}")
        return 130
    passed = report["verdict"] == "pass"
    if as_json:
        print_json(report | {"wall_s": time.perf_counter() - began})
    else:
        shown = ", inconclusive" if passed and not report["shown"] else ", shown" if passed else ""
        show(*calibration_report(report))
        show_verdict(report["verdict"], f"{shown}; estimator {report['estimator']}, {report['runs']} runs")
        show(*([TOO_FEW] if passed and not report["shown"] else []))
    say(f"Run folder: {out}")
    return 0 if passed else 1
