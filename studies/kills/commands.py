"""The commands that write, each with a small task, and what they read."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.robot import load_robot

TULIP = [sys.executable, "-c", "from tulip_testbed.cli.entry import run; run()"]
SHAPE = ["--placements", "4", "--per-placement", "4", "--seed", "107"]
FAULT = ["--statics", "--preset", "force-plate", "--effect", "cell-gain:right.front_left=0.05"]
WRITE_RIG = """
from pathlib import Path
import tulip_testbed.api
from tulip_testbed.effects.instance import instances_of
from tulip_testbed.experiments.rig_folder import write_rig
from tulip_testbed.base.errors import InputError
from tulip_testbed.sim.robot import load_robot
robot = load_robot()
try:
    write_rig(Path("out"), robot, instances_of(["cell-gain:right.front_left=0.05"], robot))
except InputError as error:
    raise SystemExit(f"tulip: {error}")
"""


@dataclass(frozen=True)
class Command:
    """A command that writes into the folder in which it is started.

    Attributes:
        name: in the tables.
        line: the whole command line.
        results: names that it writes, the one that counts first.
        last: what appears at the very end.
        resumes: whether the same command goes on after a kill.
        refusal: exit code of a message.
    """

    name: str
    line: list[str]
    results: tuple[str, ...] = ("out",)
    last: str = "out"
    resumes: bool = False
    refusal: int = 2


def tulip(
    name: str, *arguments: str, last: str = "out", more: tuple[str, ...] = (), resumes: bool = False
) -> Command:
    """Return a command of `tulip` whose result is `last`, or its first part."""
    return Command(name, [*TULIP, *arguments], (last.split("/")[0], *more), last, resumes)


COMMANDS = [
    tulip("postures --random", "postures", "--random", *SHAPE, "--out", "out"),
    tulip("postures --draw", "postures", "../plan", "--draw", "out"),
    tulip(
        "plan",
        *("plan", "--placements", "3", "--postures-per-placement", "9", "--hops", "2", "--out", "out"),
        resumes=True,
    ),
    tulip(
        "simulate --truth",
        *("simulate", "../first", "--out", "out", "--truth", "truth.json"),
        more=("truth.json",),
    ),
    tulip("validate", "validate", "../plan", "--out", "out"),
    tulip(
        "montecarlo",
        "montecarlo",
        "../plan",
        "--out",
        "out",
        "--runs",
        "75",
        last="out/report.json",
        resumes=True,
    ),
    tulip("discover", "discover", "../faulty", "--no-check", "--out", "out"),
    tulip("atlas", "atlas", "../plan", "--out", "out"),
    tulip("report", "report", "../run", "--out", "out.html", last="out.html"),
    tulip("view --save", "view", "../run", "--save", "out.rrd", last="out.rrd"),
    Command("write_rig (Python)", [sys.executable, "-c", WRITE_RIG], refusal=1),
]


def prepare(home: Path) -> None:
    """Write what the commands read into the folder above theirs."""
    for arguments in (
        ["postures", "--random", *SHAPE, "--out", "plan"],
        ["validate", "plan", "--out", "run"],
        ["simulate", "plan", "--out", "faulty", *FAULT],
    ):
        done = subprocess.run([*TULIP, *arguments], cwd=home, capture_output=True, text=True, check=False)
        assert done.returncode in (0, 1), done.stderr
    write_plan(home / "first", read_plan(home / "plan", load_robot()).take(np.array([0, 1, 4, 5])))
