"""Measure how often the verdict fails a true laboratory and one with a false cell (docs/studies/verdict.md, minutes).

Every laboratory is validated once, in statics, with the shipped plan and the default estimator.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.validate import validate
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.sim.robot import load_robot

SETTINGS = Settings(seed=3)  # a development seed
PRESETS = ("wii", "force-plate")
LABORATORIES, FALSE_LABORATORIES = 200, 5
KINDS = {
    "all errors": "full model: all errors",
    "largest z": "full model: largest |z|",
    "all errors, simplified": "simplified model: all errors",
    "largest z, simplified": "simplified model: largest |z|",
    "residual sigma": "residual sigma (mm)",
    "dropped postures": "share of dropped postures",
    "total mass": "total mass",
}


@dataclasses.dataclass(frozen=True)
class Judged:
    """The checks that failed, and the residual sigma of the default estimator and of least squares [mm]."""

    failed: frozenset[str]
    sigma: float
    least_squares: float


def judged(laboratory: Laboratory, plan: PosturePlan, seed: int, imperfections: float) -> Judged:
    """Validate a laboratory once."""
    found = validate(laboratory, plan, seed, engine="statics", workers=1, imperfections=imperfections)
    failed = frozenset(check.name for check in found.checks if check.result == "fail")
    plain = found.least_squares
    assert plain is not None
    return Judged(failed, 1e3 * found.identification.full.sigma, 1e3 * plain.full.sigma)


def with_gain(laboratory: Laboratory, cell: str) -> Laboratory:
    """Return the same laboratory with one cell that reads 10 % high."""
    sensors = dataclasses.replace(laboratory.rig.sensors, cell_gain={cell: 1.1})
    return dataclasses.replace(laboratory, nominal=dataclasses.replace(laboratory.rig, sensors=sensors))


def share(values: list[bool]) -> str:
    return f"{100 * np.mean(values):.1f} %"


def study(settings: Settings) -> Iterator[str]:
    """Yield a table of false failures and one of false cells."""
    robot = load_robot()
    plan, laboratories = shipped_plan(robot), [Laboratory(robot, preset) for preset in PRESETS]
    yield header("preset", "imperfections", *KINDS, "any check", "sigma (s.d.), mm", "by least squares")
    count = settings.count(LABORATORIES)
    for block, imperfections in enumerate((1.0, 0.0)):
        seeds = range(settings.seed + block * count, settings.seed + (block + 1) * count)
        for laboratory in laboratories:
            calls = ((laboratory, plan, seed, imperfections) for seed in seeds)
            found = settings.parallel(f"{laboratory.sensors}, {imperfections:g}", judged, calls)
            rates = [share([name in one.failed for one in found]) for name in KINDS.values()]
            rates.append(share([bool(one.failed) for one in found]))
            sigmas = ([one.sigma for one in found], [one.least_squares for one in found])
            rates += [f"{np.mean(values):.3f} ({np.std(values):.3f})" for values in sigmas]
            yield row(laboratory.sensors, f"{imperfections:g}", *rates)
    yield "\n" + header(
        "cell 10 % high", *(f"{p}: {k}" for p in PRESETS for k in ("all errors", "any check"))
    )
    first = settings.seed + 2 * count
    for cell in CELLS:
        rates = []
        for laboratory in laboratories:
            seeds = range(first, first + settings.count(FALSE_LABORATORIES))
            calls = ((with_gain(laboratory, cell), plan, seed, 1.0) for seed in seeds)
            found = settings.parallel(f"{laboratory.sensors}, {cell}", judged, calls)
            rates.append(share([KINDS["all errors"] in one.failed for one in found]))
            rates.append(share([bool(one.failed) for one in found]))
        yield row(cell, *rates)
