"""What people hand to the program: its kinds of change, an intact input, and the command that reads it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz.changes import Change
from tests.fuzz.folders import MEASUREMENT_KINDS, PLAN_KINDS
from tests.fuzz.robots import ROBOT_KINDS
from tulip_testbed.sim.shipped import ASSETS

KINDS: dict[str, dict[str, Change]] = {
    "measurements": MEASUREMENT_KINDS,
    "plan": PLAN_KINDS,
    "robot": ROBOT_KINDS,
}
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
        if target == "robot":
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


def command(target: str, folder: Path) -> list[str]:
    """Return the command that reads an input."""
    base = str(folder)
    if target == "robot":
        return ["robot", f"{base}/tulip.toml", "--json"]
    if target == "plan":
        return ["plan", "show", base, "--json"]
    return ["identify", base, "--estimator", "least-squares", "--json"]  # an independent reading solves eq. 8
