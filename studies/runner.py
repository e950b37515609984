"""Run a study by its name and print its tables as Markdown, below the command that made them.

The study NAME is the module `studies/study_NAME.py`, with `_` for `-`. It holds `SETTINGS`, those of the
published tables, and `study(settings)`, which yields lines of Markdown as soon as they are known. The first
line of its docstring is its entry in the list of studies.
"""

import ast
import importlib
import os
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_type_hints

import joblib
import tyro
from pydantic import TypeAdapter
from scipy.stats import binomtest

from tulip_testbed.base.errors import InputError, look_up
from tulip_testbed.base.files import write_text
from tulip_testbed.cli.terminal import progress
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import Robot


@dataclass(frozen=True)
class Settings:
    """How a study is run."""

    seed: int
    """first seed"""
    size: float = 1.0
    """number of runs, as a fraction of the published one"""
    workers: int = field(default_factory=joblib.cpu_count)
    """processes; the tables do not depend on their number"""
    only: tuple[str, ...] = ()
    """parts of the study"""

    def count(self, published: float) -> int:
        """Return how many runs to make where the published table has `published`."""
        return max(1, round(self.size * published))

    def folder(self, study: str) -> Path:
        """Create the folder of files that a study keeps; the same command finds them again and resumes."""
        folder = Path("runs") / f"study-{study}" / f"seed-{self.seed}-size-{self.size:g}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def parallel(self, label: str, function: Callable[..., Any], arguments: Iterable[tuple]) -> list[Any]:
        """Call a function for each tuple of arguments, spread over the processes, with a progress bar.

        Returns:
            the results in the order of the arguments.
        """
        calls, results = [joblib.delayed(function)(*each) for each in arguments], []
        with progress(label, len(calls)) as advance:
            for result in joblib.Parallel(self.workers, return_as="generator")(calls):
                results.append(result)
                advance(1)
        return results

    def kept(self, label: str, function: Callable[..., Any], calls: Mapping[Path, tuple]) -> list[Any]:
        """Do the same for the arguments of each file; keep results there, and read those that are there."""
        return self.parallel(label, kept, ((path, function, *each) for path, each in calls.items()))


def kept(path: Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Read what a function returned, of its annotated type, from a file; call it if there is none."""
    document = TypeAdapter(get_type_hints(function)["return"])
    if not path.exists():
        write_text(path, document.dump_json(function(*arguments)).decode())
    return document.validate_json(path.read_bytes())


def main(arguments: list[str]) -> int:
    """Run the study that the arguments name; return the exit code."""
    found, name = studies(), arguments[0] if arguments else "--help"
    if name in ("-h", "--help"):
        print("usage: python -m studies NAME [OPTIONS]; python -m studies NAME --help tells the options\n")
        print("\n".join(f"  {name:14} {sentence}" for name, sentence in found.items()))
        return 0
    try:
        run(look_up("study", name, found, "NAME"), arguments[1:])
    except InputError as error:
        print(f"studies: {error}", file=sys.stderr)
        return 2
    return 0


def studies() -> dict[str, str]:
    """Return what each study does by its name, read from the modules without importing them."""
    return {
        path.stem.removeprefix("study_").replace("_", "-"): str(
            ast.get_docstring(ast.parse(path.read_text()))
        ).split("\n")[0]
        for path in sorted(Path(__file__).parent.glob("study_*.py"))
    }


def run(name: str, arguments: list[str]) -> None:
    """Run one study and print its lines as they come.

    Raises:
        InputError: a part that the study does not have, or another setting that the study refuses.
    """
    module = importlib.import_module(f"studies.study_{name.replace('-', '_')}")
    prog = f"python -m studies {name}"
    settings = tyro.cli(
        type(module.SETTINGS), prog=prog, description=module.__doc__, args=arguments, default=module.SETTINGS
    )
    for part in settings.only:
        look_up("part", part, module.SETTINGS.only, "--only")
    began = datetime.now(UTC)
    print(f"`{shlex.join([*prog.split(), *arguments])}` (seed {settings.seed})\n", flush=True)
    for line in module.study(settings):
        print(line, flush=True)
    ended, load = datetime.now(UTC), os.getloadavg()[2]
    print(f"\n{began:%Y-%m-%d %H:%M} to {ended:%H:%M} UTC, workers: {settings.workers}, load {load:.1f}.")


def row(*cells: object) -> str:
    """Return one line of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def header(*cells: str) -> str:
    """Return the first two lines of a Markdown table."""
    return f"{row(*cells)}\n{'|---' * len(cells)}|"


def shipped_plan(robot: Robot, placements: int | None = None) -> PosturePlan:
    """Return the shipped plan, or its first placements."""
    plan = read_plan(DEFAULT_PLAN, robot)
    return plan if placements is None else plan.take(plan.placement <= placements)


def share(count: int, of: int) -> str:
    """Return a count and its share with the exact 95 % interval (Clopper and Pearson 1934)."""
    if not of:
        return "no case"
    low, high = binomtest(count, of).proportion_ci(0.95, "exact")
    return f"{count} of {of} ({count / of:.3f}; {low:.3f} to {high:.3f})"
