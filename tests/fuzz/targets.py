"""What people hand to the program: its kinds of change, an intact input, and the commands that read it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.fuzz.arguments import ARGUMENT_KINDS, COMMAND
from tests.fuzz.changes import Change
from tests.fuzz.folders import MEASUREMENT_KINDS, PLAN_KINDS
from tests.fuzz.names import FOLDER_KINDS, NAME_KINDS
from tests.fuzz.records import (
    DISCOVERY_KINDS,
    MONTECARLO_KINDS,
    RESUME_KINDS,
    RIG_KINDS,
    RUN_KINDS,
    STATE_KINDS,
)
from tests.fuzz.robots import PLATE_KINDS, ROBOT_KINDS
from tulip_testbed.base.progress import Advance
from tulip_testbed.effects.instance import instances_of
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.plan_search import PlanSettings, set_up_search
from tulip_testbed.experiments.planning_run import search_plan
from tulip_testbed.experiments.rig_folder import write_rig
from tulip_testbed.experiments.validate import judge
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.shipped import ASSETS

KINDS: dict[str, dict[str, Change]] = {
    "measurements": MEASUREMENT_KINDS,
    "plan": PLAN_KINDS,
    "robot": ROBOT_KINDS | PLATE_KINDS,
    "run": RUN_KINDS,
    "discovery": DISCOVERY_KINDS,
    "montecarlo": MONTECARLO_KINDS,
    "resume": RESUME_KINDS,
    "rig": RIG_KINDS,
    "state": STATE_KINDS,
    "names": NAME_KINDS,
    "folders": FOLDER_KINDS,
    "arguments": ARGUMENT_KINDS,
}
PAGES = ("run", "discovery", "montecarlo")  # a page takes seconds: only these kinds of change get one
ON_PAGES = ("another number", "hostile text", "failed")
SHAPE = ("--placements", "6", "--per-placement", "5", "--seed", "107")
SEARCHED = PlanSettings(seed=311, placements=5, postures_per_placement=6, hops=1)
INTERRUPTED = 3  # rounds
EFFECTS = ("encoder-offset:right_knee=0.01", "cell-tare:left.front_right=0.5")
Tulip = Callable[[list[str]], Any]


class Intact:
    """The inputs that nothing is wrong with, each made when it is first asked for.

    Args:
        place: an empty folder.
        tulip: runs a command.
        brief: leave the full dynamics out.
    """

    def __init__(self, place: Path, tulip: Tulip, brief: bool) -> None:
        self.place, self.tulip, self.brief = place, tulip, brief

    def __call__(self, target: str) -> Path:
        """Return the folder of an input."""
        if target in ("robot", "names"):
            return ASSETS / "tulip_mjcf"
        path = self.place / {"measurements": "data"}.get(target, target)
        if not path.exists():
            getattr(self, f"_{target}")(path)
        return path

    def _plan(self, path: Path) -> None:
        self.tulip(["plan", "random", "--out", str(path), *SHAPE])

    def _measurements(self, path: Path) -> None:
        plan = str(self("plan"))
        self.tulip(["simulate", plan, "--engine", "statics", "--workers", "1", "--out", str(path)])

    def _run(self, path: Path) -> None:
        plan = self("plan")
        if self.brief:
            robot = load_robot()
            run = Laboratory(robot, "wii").run(read_plan(plan, robot), 1, "statics")
            judge(run).save(path)
        else:
            self.tulip(["validate", str(plan), "--workers", "1", "--out", str(path)])

    def _discovery(self, path: Path) -> None:
        data = str(self.place / "with an effect")
        plan, effect = str(self("plan")), "encoder-offset:right_knee=0.03"
        self.tulip(
            ["simulate", plan, "--engine", "statics", "--workers", "1", "--out", data, "--effects", effect]
        )
        self.tulip(["discover", data, "--no-check", "--workers", "1", "--out", str(path)])

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


def commands(target: str, folder: Path, made: Path, intact: Intact) -> list[list[str]]:
    """Return the commands that read an input; each is run if those before it succeed."""
    base, robot = str(folder), ["--robot", str(folder / "tulip.toml")]
    identify = ["--estimator", "least-squares", "--json"]
    plan, data, few = str(made / "plan"), str(made / "data"), ["--placements", "3", "--per-placement", "5"]
    if target == "measurements":  # the independent reading solves eq. 8
        return [["identify", base, *identify], ["identify", base]]
    if target == "plan":
        return [["plan", "show", base, "--json"], ["plan", "show", base]]
    if target in PAGES:
        whole = str(intact(target))
        return [["report", base, whole, "--json"], ["report", base, whole]]
    if target == "resume":
        return [montecarlo(intact("plan"), folder)]
    if target == "rig":
        return [["identify", str(folder.with_name("data")), "--corrections", base, *identify]]
    if target == "state":
        number = {"placements": 5, "postures-per-placement": 6, "hops": 1, "seed": 311}
        options = [word for name, value in number.items() for word in (f"--{name}", str(value))]
        return [["plan", "optimal", "--out", str(folder / "made" / "plan"), *options, "--json"]]
    if target == "folders":
        inside = folder if (folder / "data").exists() else next(folder.iterdir())
        own, run = str(inside / "data"), str(inside / "run")
        return [
            *(["identify", own, *identify], ["identify", own], ["report", run, str(intact("run"))]),
            [
                "simulate",
                f"{run}/plan",
                "--engine",
                "statics",
                "--workers",
                "1",
                "--out",
                str(made / inside.name),
            ],
            ["report", run, "--out", f"{made / 'of'}{inside.name[:99]}.html"],
        ]
    if target == "arguments":
        path = folder / COMMAND
        return [json.loads(path.read_text()) if path.exists() else ["identify", f"{base}/data", *identify]]
    several = [] if target == "robot" else [["plan", "show", plan, *robot], ["identify", data, *robot]]
    enough = few if target == "robot" else SHAPE[:4]
    return [
        *(["robot", *robot[1:], "--json"], ["robot", *robot[1:]]),
        ["plan", "random", "--out", plan, *enough, "--seed", "107", *robot],
        ["simulate", plan, "--out", data, "--workers", "1", "--sensors", "ideal", *robot]
        if target == "robot"
        else ["simulate", plan, "--out", data, "--workers", "1", "--engine", "statics", *robot],
        *several,
    ]
