"""Measure what force-torque sensors in the feet give, with unknown zeros (docs/explanation/foot-sensors.md; 20 minutes).

The part `ideal` identifies with exact sensors: in double support alone, in the directions that the zeros do
not imitate, and on the plan of mixed support. The part `calibration` is a Monte Carlo of the preset `foot-ft`
on that plan, in a laboratory without ordinary imperfections, identified as such.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import tulip_testbed as tt
from studies.runner import Settings, header, row
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.calibration.families import EXACT
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

SETTINGS = Settings(seed=9400, only=("ideal", "calibration"))
RUNS, AT_ONCE, TRIED = 2000, 50, 5
PAIRS = (("right_hip.y", "right_foot.y"), ("left_hip.y", "left_foot.y"))  # known better by their sums


@one_blas_thread
def ideal(plan: PosturePlan, seed: int) -> tuple[int, float, float]:
    """Return confounded directions, largest error outside of them, and the same of the pairs' sums [mm]."""
    laboratory = Laboratory(load_robot(), "foot-ideal")
    found = identify(laboratory.run(plan, seed, "statics").measurements, laboratory.robot)
    error = found.full.value - laboratory.true_base_parameters(plan)
    if len(found.confounded):
        along = np.linalg.qr(found.confounded.T)[0]
        error = error - along @ (along.T @ error)
    names = list(found.full.names)
    sums = [abs(error[names.index(a)] + error[names.index(b)]) for a, b in PAIRS]
    return len(found.confounded), 1e3 * float(np.abs(error).max()), 1e3 * float(max(sums))


@one_blas_thread
def batch(seed: int, runs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return errors [m], standard errors [m] and whether the 95 % interval holds, (runs, p) each."""
    laboratory, plan = Laboratory(load_robot(), "foot-ft"), tt.plans.mixed
    true = laboratory.true_base_parameters(plan)
    off, stated, inside = [], [], []
    for run in run_statics(solve_plan(laboratory.rig, plan), np.random.SeedSequence(seed).spawn(runs)):
        found = identify(run.measurements, laboratory.robot, tolerances=EXACT)
        off.append(found.full.value - true)
        stated.append(standard_errors(found.full.covariance))
        ends = np.array([found[name].interval95 for name in found.full.names])
        inside.append((ends[:, 0] <= true) & (true <= ends[:, 1]))
    return np.array(off), np.array(stated), np.array(inside)


def study_ideal(settings: Settings) -> Iterator[str]:
    yield header(
        "plan", "seed", "directions that zeros imitate", "largest error, mm", "of the pairs' sums, mm"
    )
    for name, plan in (("random", tt.plans.random), ("mixed", tt.plans.mixed)):
        for k in range(TRIED):
            count, worst, sums = ideal(plan, settings.seed + k)
            yield row(name, settings.seed + k, count, f"{worst:.4f}", f"{sums:.4f}")


def study_calibration(settings: Settings) -> Iterator[str]:
    runs = settings.count(RUNS)
    sizes = [min(AT_ONCE, runs - first) for first in range(0, runs, AT_ONCE)]
    calls = [(settings.seed + 1000 + k, size) for k, size in enumerate(sizes)]
    found = settings.parallel("runs", batch, calls)
    off, stated, inside = (np.concatenate([part[k] for part in found]) for k in range(3))
    names = tt.identify(
        Laboratory(load_robot(), "foot-ft").run(tt.plans.mixed, settings.seed, "statics").measurements
    ).full.names
    ratio = off.std(axis=0, ddof=1) / np.sqrt((stated**2).mean(axis=0))
    coverage, bias = inside.mean(axis=0), off.mean(axis=0) / stated.mean(axis=0)
    yield f"{len(off)} runs.\n"
    yield header("parameter", "s.e., mm", "empirical over stated s.e.", "coverage of 95 %", "bias, s.e.")
    for k, name in enumerate(names):
        yield row(
            name,
            f"{1e3 * stated[:, k].mean():.3f}",
            f"{ratio[k]:.3f}",
            f"{100 * coverage[k]:.1f} %",
            f"{bias[k]:+.3f}",
        )
    yield (
        f"\nEmpirical over stated standard error: {ratio.min():.3f} to {ratio.max():.3f}, median "
        f"{np.median(ratio):.3f}. Coverage: {100 * coverage.min():.1f} to {100 * coverage.max():.1f} %, on "
        f"average {100 * coverage.mean():.1f} %.\n"
    )


def study(settings: Settings) -> Iterator[str]:
    """Yield the tables of the chosen parts."""
    for part in settings.only:
        yield f"\n{part.capitalize()}\n"
        yield from {"ideal": study_ideal, "calibration": study_calibration}[part](settings)
