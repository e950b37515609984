"""Measure how often the verdict fails a true laboratory and one with a false cell (docs/studies/verdict.md, minutes).

The shipped plan is held once; sensors, plate records and scale are drawn again for every experiment.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.experiments.checks import joint_check
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory, Run
from tulip_testbed.experiments.validate import evaluate
from tulip_testbed.identification.estimators import DEFAULT
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.sim.dynamics.dynamic_run import read_again
from tulip_testbed.sim.outcome import dropped_postures
from tulip_testbed.sim.robot import load_robot

SETTINGS = Settings(seed=3)  # a development seed
PRESETS = ("wii", "force-plate")
PLACEMENTS = (30, 10, 4)
DRAWS, FALSE_DRAWS = 200, 20
FULL = ("full model: all errors", "full model: largest |z|", "residual sigma (mm)", "total mass")


def judged(held: Run, laboratory: Laboratory, truth: np.ndarray, draw: tuple[int, ...]) -> dict:
    """Read the held postures by the sensors of another laboratory, once, and judge the result.

    Returns:
        the checks that failed, whether eq. 14 would fail, and sigma [mm].
    """
    rng = np.random.default_rng([held.seed, *draw])
    measured = read_again(laboratory.rig, held.plan, held.outcome, rng)
    found = identify(measured, laboratory.robot, estimator=DEFAULT)
    run = dataclasses.replace(held, laboratory=laboratory, measurements=measured)
    plain = identify(measured, laboratory.robot, estimator="least-squares").full
    eq14 = dataclasses.replace(plain, clustered_covariance=plain.covariance)
    return {
        "failed": {check.name for check in evaluate(run, found, truth) if check.result == "fail"},
        "eq. 14": joint_check("eq. 14", eq14, truth).result == "fail",
        "sigma": 1e3 * found.full.sigma,
    }


def first(run: Run, placements: int) -> Run:
    """Return the run of the first placements."""
    kept = tuple(a for a in run.truth.attempts if a.placement <= placements)
    truth = dataclasses.replace(run.truth, attempts=kept, dropped=dropped_postures(kept))
    return dataclasses.replace(run, plan=run.plan.take(run.plan.placement <= placements), truth=truth)


def with_gain(laboratory: Laboratory, cell: str) -> Laboratory:
    """Return the same laboratory with one cell that reads 10 % high."""
    sensors = dataclasses.replace(laboratory.rig.sensors, cell_gain={cell: 1.1})
    return dataclasses.replace(laboratory, nominal=dataclasses.replace(laboratory.rig, sensors=sensors))


def share(values: list[bool]) -> str:
    return f"{100 * np.mean(values):.1f} %"


def study(settings: Settings) -> Iterator[str]:
    """Yield a table of false failures and one of false cells."""
    robot = load_robot()
    whole = Laboratory(robot, "ideal").run(shipped_plan(robot), settings.seed, workers=settings.workers)
    laboratories = [Laboratory(robot, preset) for preset in PRESETS]
    truth = laboratories[0].true_base_parameters(whole.plan)
    kinds = ("all errors", "largest z", "residual sigma", "total mass", "any check", "all errors by eq. 14")
    yield header("preset", "placements", *kinds, "sigma (mm)")
    for count in PLACEMENTS:
        held, draws = first(whole, count), range(settings.count(DRAWS))
        for laboratory in laboratories:
            label, calls = (
                f"{laboratory.sensors}, {count}",
                ((held, laboratory, truth, (count, k)) for k in draws),
            )
            found = settings.parallel(label, judged, calls)
            rates = [share([name in one["failed"] for one in found]) for name in FULL]
            rates += [share([bool(one["failed"]) for one in found]), share([one["eq. 14"] for one in found])]
            sigma = np.array([one["sigma"] for one in found])
            yield row(laboratory.sensors, count, *rates, f"{sigma.mean():.3f} +- {sigma.std():.3f}")
    yield "\n" + header(
        "cell 10 % high", *(f"{p}: {k}" for p in PRESETS for k in ("all errors", "any check"))
    )
    draws = range(settings.count(FALSE_DRAWS))
    for number, cell in enumerate(CELLS):
        rates = []
        for laboratory in laboratories:
            false = with_gain(laboratory, cell)
            found = settings.parallel(cell, judged, ((whole, false, truth, (100 + number, k)) for k in draws))
            rates.append(share([FULL[0] in one["failed"] for one in found]))
            rates.append(share([bool(one["failed"]) for one in found]))
        yield row(cell, *rates)
