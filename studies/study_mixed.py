"""Measure the shipped plan of mixed support: errors, standing, the choice (docs/studies/planning.md; 25 minutes).

The part `errors` is a Monte Carlo in statics, `standing` holds the plan in the full dynamics, `pool` puts
random postures on one foot in the place of the optimised ones, and `numbers` plans with other numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from studies.improve.repeat import Repeated, repeat, rms
from studies.runner import Settings, header, row
from tulip_testbed.experiments.parameter_tables import read_reported
from tulip_testbed.experiments.plan_description import described_plan
from tulip_testbed.experiments.planning_run import SIGMA_MM, PlanSettings, optimal_plan
from tulip_testbed.identification.base_parameters import base_parameters, common_support
from tulip_testbed.identification.planning.mixed_plan import from_pools, random_pools
from tulip_testbed.identification.planning.optimal_plan import objective_by_name
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.shipped import PLANS

SETTINGS = Settings(seed=9200, only=("errors", "standing", "pool", "numbers"))
RUNS, AT_ONCE = 500, 50
STANDING = 3  # experiments
POOL = 8  # random postures for each on one foot
PLANNED = PlanSettings(seed=1, objective="d-optimal", placements=4, right=44, left=44)
OTHERS = [(12, 24, 24), (8, 34, 34), (4, 44, 44)]  # placements of five, right, left: 108 postures each
SUPPORTS = ("double", "right", "left")


@cache
def robot() -> Robot:
    return load_robot()


def shipped() -> PosturePlan:
    """Return the shipped plan; `tulip plan` with the settings `PLANNED` made it."""
    return read_plan(PLANS / "mixed", robot())


def wii() -> Rig:
    """Return a laboratory that measures no posture twice."""
    rig = preset_rig("wii", robot())
    return dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))


def paper_errors() -> np.ndarray:
    """Return the paper's standard errors of the parameters of double support, (25,) [mm]."""
    reported = read_reported(robot())
    assert reported is not None
    columns = ("full_mm", "full_rel_se_percent")
    table = np.array([[found[each] for each in columns] for found in reported.parameters.values()], float)
    return np.abs(table).prod(axis=1) / 100


def ratios(errors: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Return the standard errors of the parameters of double support over the paper's, (25,).

    Args:
        errors: standard errors, (p,) [mm].
        names: names of their parameters.
    """
    rows = [names.index(name) for name in base_parameters(robot()).names]
    return errors[rows] / paper_errors()


def batch(seed: int, runs: int) -> Repeated:
    """Measure the shipped plan in statics and identify it."""
    plan = shipped()
    return repeat(wii(), plan, base_parameters(robot(), support=common_support(plan.support)), runs, seed)


def study_errors(settings: Settings) -> Iterator[str]:
    runs = settings.count(RUNS)
    sizes = [min(AT_ONCE, runs - first) for first in range(0, runs, AT_ONCE)]
    found = settings.parallel("runs", batch, [(settings.seed + k, size) for k, size in enumerate(sizes)])
    names = base_parameters(robot(), support=common_support(shipped().support)).names
    stated = 1e3 * np.concatenate([part.full.error for part in found])
    off = 1e3 * np.concatenate([part.full.off for part in found])
    held = np.concatenate([part.rows for part in found])
    mean, actual = stated.mean(axis=0), rms(off)
    inside = (np.abs(off) < 1.96 * stated).mean(axis=0)
    share, real = ratios(mean, names), ratios(actual, names)
    yield (
        f"{len(held)} runs of {len(shipped())} postures, {held.mean():.1f} measured, "
        f"{sum(part.failed for part in found)} runs without an estimate.\n"
    )
    yield header("number", "parameter", "s.e., mm", "RMS error, mm", "paper's s.e., mm", "s.e./paper")
    for k, name in enumerate(base_parameters(robot()).names):
        at = names.index(name)
        figures = (mean[at], actual[at], paper_errors()[k], share[k])
        yield row(k + 1, name, *(f"{x:.2f}" for x in figures))
    for at, name in enumerate(names):
        if name not in base_parameters(robot()).names:
            yield row("", name, f"{mean[at]:.2f}", f"{actual[at]:.2f}", "", "")
    yield (
        f"\nStandard error over the paper's: median {np.median(share):.3f}, largest {share.max():.3f}; "
        f"RMS error over it: median {np.median(real):.3f}, largest {real.max():.3f}. RMS error over standard "
        f"error: {np.median(actual / mean):.3f} in the median, {(actual / mean).min():.2f} to "
        f"{(actual / mean).max():.2f}; within 1.96 standard errors: {100 * inside.mean():.1f} %.\n"
    )


def stood(seed: int) -> list[int]:
    """Hold the shipped plan in the full dynamics; return how many postures of each support stood."""
    support = run_dynamics(wii(), shipped(), seed).measurements.support
    return [int((support == each).sum()) for each in SUPPORTS]


def study_standing(settings: Settings) -> Iterator[str]:
    seeds = [settings.seed + k for k in range(settings.count(STANDING))]
    planned = [int((shipped().support == each).sum()) for each in SUPPORTS]
    yield header("seed", *(f"{each}, of {n}" for each, n in zip(SUPPORTS, planned, strict=True)), "all")
    for seed, found in zip(
        seeds, settings.parallel("experiments", stood, [(s,) for s in seeds]), strict=True
    ):
        yield row(seed, *found, f"{sum(found)} of {sum(planned)}")


def figures(plan: PosturePlan) -> list[Any]:
    """Return what a plan promises: its criterion, the median and the largest error over the paper's."""
    support = common_support(plan.support)
    parameters = base_parameters(robot(), support=support)
    rows = parameters.regressor(plan.joint_angles, plan.support).reshape(-1, len(parameters.names))
    problem = planning_problem(robot(), nominal_plates(robot())[0], support=support)
    criterion = objective_by_name(problem, PLANNED.objective, 1e-3 * SIGMA_MM).value(rows.T @ rows)
    said = described_plan(robot(), plan, "wii")
    share = ratios(np.array(said["predicted_standard_error_mm"]), parameters.names)
    said = (criterion, np.exp(criterion / 2), np.median(share), share.max(), said["condition_number"])
    return [f"{x:.{digits}f}" for x, digits in zip(said, (3, 3, 3, 3, 1), strict=True)]


COLUMNS = (
    "criterion",
    "geometric mean s.e./sigma",
    "median of s.e./paper",
    "largest",
    "condition number",
)


def study_pool(settings: Settings) -> Iterator[str]:
    """Yield the criterion with random postures on one foot, chosen or not, in addition to the optimised ones."""
    plan, counts = shipped(), PLANNED.on_one_foot
    problem = planning_problem(robot(), nominal_plates(robot())[0], support=common_support(plan.support))
    goal = objective_by_name(problem, PLANNED.objective, 1e-3 * SIGMA_MM)
    pools = random_pools(problem, counts, settings.seed, POOL)
    both = problem.parameters.regressor(plan.joint_angles[plan.support == "double"])
    rest = np.einsum("mip,miq->pq", both, both)
    yield header("postures on one foot", *COLUMNS)
    chosen = from_pools(pools, counts, rest, goal.smooth[-1])
    first = [dataclasses.replace(one, angles=one.angles[: counts[one.support]]) for one in pools]
    for name, single in (("random", first), ("the best of up to eight times as many random ones", chosen)):
        angles = plan.joint_angles.copy()
        for one in single:
            angles[plan.support == one.support] = one.angles
        yield row(name, *figures(dataclasses.replace(plan, joint_angles=angles)))
    yield row("optimised", *figures(plan))


def study_numbers(settings: Settings) -> Iterator[str]:
    yield header("double + right + left", *COLUMNS)
    for placements, right, left in OTHERS:
        wanted = dataclasses.replace(PLANNED, placements=placements, right=right, left=left)
        yield row(f"{5 * placements} + {right} + {left}", *figures(optimal_plan(robot(), wanted)))


PARTS = {"errors": study_errors, "standing": study_standing, "pool": study_pool, "numbers": study_numbers}


def study(settings: Settings) -> Iterator[str]:
    """Yield the tables of the parts."""
    for part in settings.only:
        yield f"\n### {part}\n"
        yield from PARTS[part](settings)
