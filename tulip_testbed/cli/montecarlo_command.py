"""`tulip montecarlo`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import tyro

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
from tulip_testbed.experiments.montecarlo.calibration_tables import print_report
from tulip_testbed.experiments.montecarlo.engine import ENGINES
from tulip_testbed.experiments.montecarlo.montecarlo_run import Interrupted, Place, montecarlo
from tulip_testbed.experiments.montecarlo.settings import Settings, check_settings
from tulip_testbed.experiments.preparation import identifiable_regressor, planned_parameters, read_scenario
from tulip_testbed.experiments.scenario import DEFAULT_PLAN, DEFAULT_SEED
from tulip_testbed.experiments.terminal import ERR, console, print_json, printable
from tulip_testbed.identification.estimators import DEFAULT
from tulip_testbed.sim.errors import InputError
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
    settings = Settings(runs, seed, estimator, random_robots, dynamics)
    check_settings(settings, engine, address)
    if preset == "ideal":
        raise InputError(
            "--preset ideal: found no noise, so no standard errors to judge; valid: wii, force-plate"
        )
    scenario = read_scenario(plan, preset, seed, robot, workers, rig, statics=not dynamics)
    identifiable_regressor(
        str(plan or DEFAULT_PLAN), scenario.plan, planned_parameters(scenario.rig.robot, scenario.plan)
    )
    try:
        report = montecarlo(scenario, settings, Place(out, workers, address))
    except Interrupted as stopped:
        ERR.print(printable(f"tulip: {stopped}"), markup=False, highlight=False, soft_wrap=True)
        return 130
    if as_json:
        print_json(report | {"wall_s": time.perf_counter() - began})
    else:
        print_report(console(), report)
    ERR.print(f"Run folder: {out}")
    return 0 if report["verdict"] == "pass" else 1
