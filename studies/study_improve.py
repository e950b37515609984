"""Try the paper's ways to improve its estimates (docs/studies/improve.md; seventeen minutes of one core).

The folder of the study gets the tables as CSV, the figures, and the pool of random postures.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from studies.improve import accuracy, conditioning, postures, simplified, single_support
from studies.improve.output import Rows, table
from studies.runner import Settings, shipped_plan
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.scene import nominal_plates

POOL = 6250  # the rule of thumb: 500 data points a parameter, two a posture
MIXTURES = [(150, 0), (125, 25), (100, 50), (75, 75), (150, 50), (150, 150), (300, 0)]
SPREADS = [0.02, 0.05, 0.1, 0.2, 0.5]
SIZES = {50: 200, 150: 200, 500: 100, 1500: 50, POOL: 24}


@dataclass(frozen=True)
class Work:
    """The inputs of all parts."""

    settings: Settings
    robot: Robot
    folder: Path

    @property
    def seed(self) -> int:
        return self.settings.seed

    @cached_property
    def wii(self) -> Rig:
        return preset_rig("wii", self.robot)

    @cached_property
    def parameters(self) -> BaseParameters:
        return base_parameters(self.robot)

    @cached_property
    def pool(self) -> PosturePlan:
        """Return random postures, five a placement, drawn once."""
        folder = self.folder / "pool"
        if not folder.exists():
            plate = nominal_plates(self.robot)[0]
            write_plan(folder, random_postures(self.robot, plate, POOL // 5, 5, self.seed))
        return read_plan(folder, self.robot)

    def table(self, name: str, rows: Rows) -> Iterator[str]:
        return table(self.folder / f"improve-{name}.csv", rows)

    def picture(self, name: str) -> Path:
        return self.folder / f"improve-{name}.png"


def study_accuracy(work: Work) -> Iterator[str]:
    runs = work.settings.count(300)
    rows = accuracy.study(work.wii, shipped_plan(work.robot), work.parameters, runs, work.seed + 1)
    yield from work.table("accuracy", rows)
    accuracy.draw(rows, work.picture("accuracy"))


def study_postures(work: Work) -> Iterator[str]:
    runs = {size: work.settings.count(published) for size, published in SIZES.items()}
    sizes, rows = postures.study(work.wii, work.pool, work.parameters, runs, work.seed + 2)
    yield from work.table("postures", sizes)
    yield from work.table("postures-parameters", rows)
    postures.draw(sizes, rows, work.picture("postures"))


def study_conditioning(work: Work) -> Iterator[str]:
    rng = np.random.default_rng(work.seed + 3)
    plans = conditioning.choose(work.pool, work.parameters, rng)
    optimal = read_plan(DEFAULT_PLAN.parent / "optimal", work.robot)
    runs, seed = work.settings.count(120), work.seed + 100
    rows = conditioning.study(work.wii, [*plans, ("optimal", optimal)], work.parameters, runs, seed)
    yield from work.table("conditioning", rows)
    yield from work.table("conditioning-predictions", conditioning.predictions(rows, work.seed))
    conditioning.draw(rows, work.picture("conditioning"))


def study_single_support(work: Work) -> Iterator[str]:
    one_foot = single_support.one_foot_postures(work.robot, 150, np.random.default_rng(work.seed + 5))
    runs = work.settings.count(120)
    rows, errors = single_support.study(work.wii, work.pool, one_foot, MIXTURES, work.seed + 6, runs)
    yield from work.table("single-support", rows)
    yield from work.table("single-support-parameters", errors)
    single_support.draw(errors, [(150, 0), (75, 75), (300, 0)], work.picture("single-support"))


def study_simplified(work: Work) -> Iterator[str]:
    plan, more, count = (
        shipped_plan(work.robot),
        work.pool.take(work.pool.placement <= 600 // 5),
        work.settings.count,
    )
    middle = dataclasses.replace(work.wii, sensors=accuracy.between(0.5))
    arms = {
        "wii, 150 postures": (work.wii, plan, count(150)),
        "wii, 600 postures": (work.wii, more, count(60)),
        "between, 150 postures": (middle, plan, count(150)),
        "force-plate, 150 postures": (preset_rig("force-plate", work.robot), plan, count(150)),
    }
    new = work.pool.joint_angles[-500:]
    rows = simplified.study(arms, SPREADS, new, work.parameters, work.seed + 4)
    yield from work.table("simplified", rows)
    yield from work.table("simplified-crossings", simplified.crossings(rows))
    simplified.draw(rows, work.picture("simplified"))


PARTS: dict[str, Callable[[Work], Iterator[str]]] = {
    "accuracy": study_accuracy,
    "postures": study_postures,
    "conditioning": study_conditioning,
    "single-support": study_single_support,
    "simplified": study_simplified,
}
SETTINGS = Settings(seed=500, only=tuple(PARTS))  # the sizes and margins were chosen on seeds below 100


def study(settings: Settings) -> Iterator[str]:
    """Yield the tables of each part."""
    work = Work(settings, load_robot(), settings.folder("improve"))
    for name in settings.only:
        began = time.process_time()
        yield from PARTS[name](work)
        yield f"\n{name}: {time.process_time() - began:.0f} s of one core"
