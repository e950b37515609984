"""`tulip simulate`."""

from __future__ import annotations

from pathlib import Path

from experiments.commands.options import CORES, Json, Plan, Preset, RobotFile, Seed, Workers
from experiments.run_folder import check_new, write_experiment
from experiments.scenario import DEFAULT_SEED
from experiments.setting_up import read_scenario, tries
from experiments.tables import (
    print_experiment,
)
from experiments.terminal import ERR, console, print_json, progress
from sim.errors import InputError
from sim.laboratory import run_experiment
from sim.model import TULIP


def simulate_command(
    plan: Plan = None,
    /,
    *,
    out: Path,
    preset: Preset = "wii",
    seed: Seed = DEFAULT_SEED,
    truth: Path | None = None,
    workers: Workers = CORES,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Simulate the experiment and write a measurement folder, without the truth.

    --truth FILE writes what really happened, elsewhere.
    Example: tulip simulate --out data/first --preset force-plate --truth first-truth.json
    """
    check_new(out)
    if truth is not None:
        check_new(truth)
    if truth is not None and truth.resolve().is_relative_to(out.resolve()):
        raise InputError(f"{truth}: lies inside the measurement folder, which must not hold the truth")
    if truth is not None and out.resolve().is_relative_to(truth.resolve()):
        raise InputError(f"{out}: lies inside {truth}, which is to be a file")
    scenario = read_scenario(plan, preset, seed, robot, workers)
    with progress("holding postures", tries(scenario)) as advance:
        experiment = run_experiment(scenario.rig, scenario.plan, seed, workers, advance)
    write_experiment(out, truth, scenario, experiment)
    if as_json:
        print_json(
            {
                "measurements": str(out),
                "postures_planned": scenario.plan.postures,
                "rows": len(experiment.measurements),
                "dropped": [{"posture": p, "reason": r} for p, r in experiment.dropped],
            }
        )
    else:
        print_experiment(console(), experiment, scenario.plan.postures, {})
    ERR.print(f"Measurement folder: {out}")
    return 0
