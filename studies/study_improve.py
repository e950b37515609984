"""The paper's possible ways to improve, as five studies: docs/improve.md's tables and figures.

A study writes docs/improve-NAME*.csv and docs/improve-NAME.png and prints its tables. The pool of random
postures is kept in the folder given by --work.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from studies.improve import accuracy, conditioning, postures, simplified, single_support
from studies.improve.one_foot import one_foot_postures
from studies.improve.output import Rows, show, write_csv
from studies.runner import part_of, shipped_plan
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.sim.measurements import PosturePlan, read_plan, write_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.scene import nominal_plates

SEED = 500  # from 500 on: the sizes and margins were chosen on seeds below 100
POOL = 6250  # the rule of thumb: 500 data points a parameter, two a posture
MIXTURES = [(150, 0), (125, 25), (100, 50), (75, 75), (150, 50), (150, 150), (300, 0)]
SPREADS = [0.02, 0.05, 0.1, 0.2, 0.5]
SIZES = {50: 200, 150: 200, 500: 100, 1500: 50, POOL: 24}


@dataclass(frozen=True)
class Work:
    """Where a study works.

    Attributes:
        docs: for tables and figures. folder: for what is kept between studies.
        plans: folders of plans to compare with those of the third study.
    """

    robot: Robot
    docs: Path
    folder: Path
    seed: int
    plans: tuple[Path, ...] = ()

    @cached_property
    def parameters(self) -> BaseParameters:
        return base_parameters(self.robot)

    @cached_property
    def pool(self) -> PosturePlan:
        """Random postures, five a placement; drawn once."""
        folder = self.folder / f"pool-{self.seed}"
        if not folder.exists():
            geometry = nominal_plates(self.robot)[0]
            folder.parent.mkdir(parents=True, exist_ok=True)
            write_plan(folder, random_postures(self.robot, geometry, POOL // 5, 5, self.seed))
        return read_plan(folder, self.robot)

    def table(self, name: str, rows: Rows) -> None:
        write_csv(self.docs / f"improve-{name}.csv", rows)
        show(name, rows)

    def picture(self, name: str) -> Path:
        return self.docs / f"improve-{name}.png"


def study_accuracy(work: Work) -> None:
    plan = shipped_plan(work.robot)
    rows = accuracy.study(preset_rig("wii", work.robot), plan, work.parameters, 300, work.seed + 1)
    work.table("accuracy", rows)
    accuracy.draw(rows, work.picture("accuracy"))


def study_postures(work: Work) -> None:
    sizes, rows = postures.study(
        preset_rig("wii", work.robot), work.pool, work.parameters, SIZES, work.seed + 2
    )
    work.table("postures", sizes)
    work.table("postures-parameters", rows)
    postures.draw(sizes, rows, work.picture("postures"))


def study_conditioning(work: Work) -> None:
    rng = np.random.default_rng(work.seed + 3)
    plans = conditioning.choose(work.pool, work.parameters, conditioning.Size(), rng)
    optimal = DEFAULT_PLAN.parent / "optimal"
    for folder in [*([optimal] if optimal.exists() else []), *work.plans]:
        plans.append((folder.name, read_plan(folder, work.robot)))
    rows = conditioning.study(preset_rig("wii", work.robot), plans, work.parameters, 120, work.seed + 100)
    work.table("conditioning", rows)
    work.table("conditioning-predictions", conditioning.predictions(rows, work.seed))
    conditioning.draw(rows, work.picture("conditioning"))


def study_single_support(work: Work) -> None:
    wii = preset_rig("wii", work.robot)
    one_foot = one_foot_postures(work.robot, 150, np.random.default_rng(work.seed + 5))
    rows, errors = single_support.study(wii, work.pool, one_foot, MIXTURES, work.seed + 6, 120)
    work.table("single-support", rows)
    work.table("single-support-parameters", errors)
    single_support.draw(errors, [(150, 0), (75, 75), (300, 0)], work.picture("single-support"))


def study_simplified(work: Work) -> None:
    wii = preset_rig("wii", work.robot)
    plan, more = shipped_plan(work.robot), part_of(work.pool, work.pool.placement <= 600 // 5)
    middle = dataclasses.replace(wii, sensors=accuracy.between(0.5))
    arms = {
        "wii, 150 postures": (wii, plan, 150),
        "wii, 600 postures": (wii, more, 60),
        "between, 150 postures": (middle, plan, 150),
        "force-plate, 150 postures": (preset_rig("force-plate", work.robot), plan, 150),
    }
    new = work.pool.joint_angles[-500:]
    rows = simplified.study(arms, SPREADS, new, work.parameters, work.seed + 4)
    work.table("simplified", rows)
    work.table("simplified-crossings", simplified.crossings(rows))
    simplified.draw(rows, work.picture("simplified"))


STUDIES: dict[str, Callable[[Work], None]] = {
    "accuracy": study_accuracy,
    "postures": study_postures,
    "conditioning": study_conditioning,
    "single-support": study_single_support,
    "simplified": study_simplified,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--work", type=Path, default=Path("runs/study-improve"))
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", nargs="+", choices=list(STUDIES), default=list(STUDIES))
    parser.add_argument("--plans", nargs="*", type=Path, default=[], help="more plan folders to condition by")
    options = parser.parse_args()
    work = Work(load_robot(), options.out, options.work, options.seed, tuple(options.plans))
    for name in options.only:
        began = time.process_time()
        STUDIES[name](work)
        print(f"\n{name}: {time.process_time() - began:.0f} s of one core", flush=True)


if __name__ == "__main__":
    main()
