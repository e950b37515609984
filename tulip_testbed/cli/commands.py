"""The commands of the command line: which function of the library each of them calls."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

API = Path(__file__).parent.parent / "api"


@dataclass(frozen=True)
class Command:
    """A command made from a function of `tulip_testbed.api`.

    Attributes:
        function: its name there. examples: command lines for the help.
        saved: whether it has an option --out for a result that the function does not write itself.
    """

    function: str
    examples: tuple[str, ...]
    saved: bool = False

    @property
    def summary(self) -> str:
        """Return the first line of the function's docstring, without loading the library."""
        return _summaries()[self.function]

    def load(self) -> Callable[..., int]:
        """Return the function that tyro calls with the options."""
        from tulip_testbed.cli.generated import command_of

        return command_of(
            getattr(import_module("tulip_testbed.api"), self.function), self.examples, self.saved
        )


@cache
def _summaries() -> dict[str, str]:
    """Return the first line of the docstring of every function of the API, by name."""
    parsed = (ast.parse(path.read_text(encoding="utf-8")) for path in API.glob("*.py"))
    functions = [node for tree in parsed for node in tree.body if isinstance(node, ast.FunctionDef)]
    return {one.name: (ast.get_docstring(one) or "").partition("\n")[0] for one in functions}


COMMANDS: dict[str, Command] = {
    "check": Command("check", ("tulip check data/first",)),
    "export": Command("export_model", ("tulip export runs/first --out identified.xml",)),
    "import": Command(
        "import_table",
        ("tulip import standing.csv --robot my/robot/robot.toml --map contacts.toml --out data/standing",),
    ),
    "predict": Command("predict", ("tulip predict data/first", "tulip predict data/first --train 1-40")),
    "robot": Command(
        "describe_robot", ("tulip robot g1_29dof.urdf --out my/g1", "tulip robot my/g1/robot.toml")
    ),
}
