"""`tulip montecarlo`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import tyro

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
from tulip_testbed.experiments.laboratory import DEFAULT_SEED
from tulip_testbed.experiments.montecarlo.calibration_tables import (
    LEGEND,
    TOO_FEW,
    calibration_check_table,
    calibration_lines,
    calibration_table,
    spread_table,
)
from tulip_testbed.experiments.montecarlo.engine import ENGINES, check_engine
from tulip_testbed.experiments.montecarlo.montecarlo_run import Interrupted, Place, montecarlo
from tulip_testbed.experiments.montecarlo.settings import Settings, check_settings
from tulip_testbed.identification.estimators import DEFAULT
from tulip_testbed.sim.errors import at_least
from tulip_testbed.sim.robot import TULIP

EngineName = Annotated[
    str, tyro.conf.arg(metavar="{" + ",".join(ENGINES) + "}", help="where the runs are computed")
]
Address = Annotated[
    str | None, tyro.conf.arg(metavar="tcp://HOST:PORT", help="of the scheduler, with --engine dask")
]
Spread = Annotated[
    float | None,
    tyro.conf.arg(
        metavar="SPREAD",
        help="a random true robot in every run: s.d. of the logarithm of each link's mass, and of its "
        "centre of mass in half edges of its inertia box",
    ),
]
Dynamics = Annotated[bool, tyro.conf.arg(help="hold every run in the full dynamics, about a minute each")]


def montecarlo_command(
    plan: Plan = None,
    /,
    *,
    out: Path,
    runs: int,
    preset: Preset = "wii",
    estimator: EstimatorName = DEFAULT,
    rig: RigFolder = None,
    engine: EngineName = "loky",
    address: Address = None,
    workers: Workers = CORES,
    seed: Seed = DEFAULT_SEED,
    random_robots: Spread = None,
    dynamics: Dynamics = False,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Repeat an experiment with known truth and ask whether the estimator is right about its own errors.

    With --rig RIG the laboratory has the rig's effects, and the measurements are freed of them.
    The same command resumes a run that was stopped, and reports again on a finished one.
    Exit code 0: every check passed; 1: a check failed; 2: could not run; 130: interrupted.
    Example: tulip montecarlo --out runs/calibration --runs 1000
    """
    began = time.perf_counter()
    at_least("workers", workers, 1)
    settings = Settings(runs, seed, estimator, random_robots, "dynamics" if dynamics else "statics")
    check_settings(settings)
    check_engine(engine, address)
    laboratory, made = laboratory_and_plan(robot, preset, plan, rig)
    try:
        report = montecarlo(laboratory, made, settings, Place(out, workers, address), progress).report.plain()
    except Interrupted as stopped:
        say(f"tulip: {stopped}")
        return 130
    if as_json:
        print_json(report | {"wall_s": time.perf_counter() - began})
    else:
        _show(report)
    say(f"Run folder: {out}")
    return 0 if report["verdict"] == "pass" else 1


def _show(report: dict[str, Any]) -> None:
    models = {"full": report["parameters"], "simplified": report["simplified"]["parameters"]}
    show(*(calibration_table(model, rows) for model, rows in models.items() if rows))
    show(
        LEGEND,
        "",
        spread_table(report),
        *calibration_lines(report),
        "",
        calibration_check_table(report["checks"]),
    )
    passed = report["verdict"] == "pass"
    shown = ", inconclusive" if passed and not report["shown"] else ", shown" if passed else ""
    show_verdict(report["verdict"], f"{shown}; estimator {report['estimator']}, {report['runs']} runs")
    if passed and not report["shown"]:
        show(TOO_FEW)
