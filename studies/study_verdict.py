"""How often does the verdict fail a true laboratory, and find a false cell? Two Markdown tables.

The shipped plan is held once; sensors, plate records and scale are drawn anew for every experiment.
docs/verdict.md holds the result.
"""

from __future__ import annotations

import argparse
import dataclasses

import joblib
import numpy as np

from studies.runner import header, part_of, row, shipped_plan
from tulip_testbed.experiments.checks import joint_check
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.validate import evaluate
from tulip_testbed.sim.dynamics.dynamic_run import read_again, run_dynamics
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import CELLS

SEED = 3  # a development seed
PRESETS = ("wii", "force-plate")
PLACEMENTS = (30, 10, 4)
FALSE_DRAWS = 20


def judged(scenario: Scenario, experiment: Experiment, truth: np.ndarray, draw: tuple[int, ...]) -> dict:
    """One experiment's checks that failed, eq. 14's own answer, and sigma [mm]."""
    rng = np.random.default_rng([SEED, *draw])
    measured = read_again(scenario.rig, scenario.plan, experiment, rng)
    again = dataclasses.replace(experiment, measurements=measured)
    found = identify(measured, scenario.rig.robot)
    checks = evaluate(scenario, again, found, truth)
    eq14 = dataclasses.replace(found.full, clustered_covariance=found.full.covariance)
    return {
        "failed": {check.name for check in checks if check.result == "fail"},
        "eq. 14": joint_check("eq. 14", eq14, truth).result == "fail",
        "sigma": 1e3 * found.full.sigma,
    }


def first(experiment: Experiment, placements: int) -> Experiment:
    kept = tuple(a for a in experiment.attempts if a.placement <= placements)
    return dataclasses.replace(experiment, attempts=kept)


def with_gain(rig: Rig, cell: str) -> Rig:
    """The same laboratory with one cell that reads a tenth too much."""
    return dataclasses.replace(rig, sensors=dataclasses.replace(rig.sensors, cell_gain={cell: 1.1}))


def share(values: list[bool]) -> str:
    return f"{100 * np.mean(values):.1f} %"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200, help="per preset and number of placements")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    ideal = preset_rig("ideal")
    plan = shipped_plan(ideal.robot)
    experiment = run_dynamics(ideal, plan, SEED, arguments.workers)
    pool = joblib.Parallel(n_jobs=arguments.workers)
    whole = {preset: Scenario(preset_rig(preset), plan, SEED, preset) for preset in PRESETS}
    truth = whole[PRESETS[0]].true_base_parameters()
    kinds = ("all errors", "largest z", "residual sigma", "total mass", "any check", "all errors by eq. 14")
    print(header("preset", "placements", *kinds, "sigma (mm)"))
    for count in PLACEMENTS:
        for preset, scenario in whole.items():
            some = dataclasses.replace(scenario, plan=part_of(plan, plan.placement <= count))
            held = first(experiment, count)
            observed = pool(
                joblib.delayed(judged)(some, held, truth, (count, k)) for k in range(arguments.draws)
            )
            full = {"all errors": "full model: all errors", "largest z": "full model: largest |z|"}
            full |= {"residual sigma": "residual sigma (mm)", "total mass": "total mass"}
            rates = [share([name in one["failed"] for one in observed]) for name in full.values()]
            rates += [
                share([bool(one["failed"]) for one in observed]),
                share([one["eq. 14"] for one in observed]),
            ]
            sigma = np.array([one["sigma"] for one in observed])
            print(row(preset, count, *rates, f"{sigma.mean():.3f} +- {sigma.std():.3f}"), flush=True)
    print(
        "\n" + header("cell 10 % high", *(f"{p}: {k}" for p in PRESETS for k in ("all errors", "any check")))
    )
    for number, cell in enumerate(CELLS):
        rates = []
        for scenario in whole.values():
            false = dataclasses.replace(scenario, rig=with_gain(scenario.rig, cell))
            draws = ((100 + number, k) for k in range(FALSE_DRAWS))
            observed = pool(joblib.delayed(judged)(false, experiment, truth, draw) for draw in draws)
            rates.append(share(["full model: all errors" in one["failed"] for one in observed]))
            rates.append(share([bool(one["failed"]) for one in observed]))
        print(row(cell, *rates), flush=True)


if __name__ == "__main__":
    main()
