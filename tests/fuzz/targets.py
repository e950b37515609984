"""What people hand to the program: its kinds of change, an intact input, and the command that reads it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.fuzz import records
from tests.fuzz.arguments import ARGUMENT_KINDS, COMMAND
from tests.fuzz.changes import Change
from tests.fuzz.folders import MEASUREMENT_KINDS, PLAN_KINDS
from tests.fuzz.names import FOLDER_KINDS, NAME_KINDS
from tests.fuzz.robots import ROBOT_KINDS
from tests.rigs import write_rig
from tulip_testbed.base.progress import Advance
from tulip_testbed.effects.instance import instances_of
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.planning_run import PlanSettings, search_plan, set_up_search
from tulip_testbed.experiments.validate import judge
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.shipped import ASSETS

KINDS: dict[str, dict[str, Change]] = {
    "measurements": MEASUREMENT_KINDS,
    "plan": PLAN_KINDS,
    "robot": ROBOT_KINDS,
    "run": records.RUN_KINDS,
    "montecarlo": records.MONTECARLO_KINDS,
    "resume": records.RESUME_KINDS,
    "rig": records.RIG_KINDS,
    "state": records.STATE_KINDS,
    "names": NAME_KINDS,
    "folders": FOLDER_KINDS,
    "arguments": ARGUMENT_KINDS,
}
SEARCHED = PlanSettings(seed=311, placements=5, postures_per_placement=6, hops=1)
INTERRUPTED = 3  # rounds
EFFECTS = ("encoder-offset:right_knee=0.01", "cell-tare:left.front_right=0.5")
IDENTIFY = ("--estimator", "least-squares", "--json")
Tulip = Callable[[list[str]], Any]


class Intact:
    """The inputs that nothing is wrong with, each made when it is first asked for.

    Args:
        place: an empty folder.
        tulip: runs a command.
    """

    def __init__(self, place: Path, tulip: Tulip) -> None:
        self.place, self.tulip = place, tulip

    def __call__(self, target: str) -> Path:
        """Return the folder of an input."""
        if target in ("robot", "names"):
            return ASSETS / "tulip_mjcf"
        path = self.place / {"measurements": "data"}.get(target, target)
        if not path.exists():
            getattr(self, f"_{target}")(path)
        return path

    def _plan(self, path: Path) -> None:
        shape = ["--placements", "6", "--per-placement", "5", "--seed", "107"]
        self.tulip(["plan", "random", "--out", str(path), *shape])

    def _measurements(self, path: Path) -> None:
        how = ["--engine", "statics", "--workers", "1"]
        self.tulip(["simulate", str(self("plan")), *how, "--out", str(path)])

    def _run(self, path: Path) -> None:
        robot = load_robot()
        run = Laboratory(robot, "wii").run(read_plan(self("plan"), robot), 1, "statics")
        judge(run).save(path)

    def _montecarlo(self, path: Path) -> None:
        self.tulip(montecarlo(self("plan"), path))

    def _resume(self, path: Path) -> None:
        shutil.copytree(self("montecarlo"), path)

    def _rig(self, path: Path) -> None:
        robot = load_robot()
        write_rig(path, robot, instances_of(EFFECTS, robot))

    def _state(self, path: Path) -> None:
        (path / "made").mkdir(parents=True)

        @contextmanager
        def stopping(what: str, total: int, done: int) -> Iterator[Advance]:
            left = iter(range(INTERRUPTED - 1))

            def stop(count: int, /, value: float | None = None) -> None:
                next(left)

            yield stop

        with suppress(StopIteration):  # in the place of a kill
            search_plan(
                set_up_search(load_robot(), SEARCHED), path / "made" / "plan", "wii", progress=stopping
            )

    def _folders(self, path: Path) -> None:
        for target in ("measurements", "run"):
            shutil.copytree(self(target), path / self(target).name)

    def _arguments(self, path: Path) -> None:
        self._folders(path)
        shutil.copytree(self("plan"), path / "plan")


def montecarlo(plan: Path, out: Path) -> list[str]:
    return ["montecarlo", str(plan), "--runs", "3", "--workers", "1", "--out", str(out), "--json"]


def command(target: str, folder: Path, intact: Intact) -> list[str]:
    """Return the command that reads an input."""
    base = str(folder)
    if target in ("robot", "names"):
        return ["robot", f"{base}/tulip.toml", "--json"]
    if target == "measurements":  # the independent reading solves eq. 8
        return ["identify", base, *IDENTIFY]
    if target == "plan":
        return ["plan", "show", base, "--json"]
    if target in ("run", "montecarlo"):
        return ["report", base, str(intact(target)), "--json"]
    if target == "resume":
        return montecarlo(intact("plan"), folder)
    if target == "rig":
        return ["identify", str(folder.with_name("data")), "--corrections", base, *IDENTIFY]
    if target == "state":
        options = "--placements 5 --postures-per-placement 6 --hops 1 --seed 311 --json"
        return ["plan", "optimal", "--out", f"{base}/made/plan", *options.split()]
    if target == "arguments" and (folder / COMMAND).exists():
        return json.loads((folder / COMMAND).read_text())
    inside = folder if (folder / "data").exists() else next(folder.iterdir())
    return ["identify", str(inside / "data"), *IDENTIFY]
