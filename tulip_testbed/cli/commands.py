"""The commands of the command line: which function of the library each of them calls."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from tulip_testbed.cli.signatures import public_function, summary_of

Saved = bool | Literal["required"]


@dataclass(frozen=True)
class Command:
    """A command made from a function of `tulip_testbed.api`.

    Attributes:
        function: its name there. examples: command lines for the help.
        saved: whether it has an option --out for its result, and whether that is required.
        brief: whether it shows the answer alone, and everything with an option --full.
    """

    function: str
    examples: tuple[str, ...]
    saved: Saved = False
    brief: bool = False

    @property
    def summary(self) -> str:
        """Return the first line of the function's docstring."""
        return summary_of(self.function)

    def load(self) -> Callable[..., int]:
        """Return the function that tyro calls with the options."""
        from tulip_testbed.cli.generated import command_of

        return command_of(public_function(self.function), self.examples, self.saved, self.brief)


# A name may have two words.
COMMANDS: dict[str, Command] = {
    "validate": Command(
        "validate",
        ("tulip validate --out runs/first", "tulip validate --out runs/exact --imperfections 0"),
        saved="required",
    ),
    "simulate": Command(
        "simulate",
        (
            "tulip simulate --out data/first --effects encoder-offset:right_knee=0.01 --truth truth.json",
            "tulip simulate --out data/real --imperfections 1 --truth real.json",
            "tulip simulate --experiment plans/next --out data/second",
        ),
    ),
    "montecarlo": Command(
        "monte_carlo",
        (
            "tulip montecarlo --out runs/coverage --runs 1000",
            "tulip montecarlo --out runs/exact --runs 200 --imperfections 0",
        ),
        saved="required",
    ),
    "check": Command("check", ("tulip check data/first",)),
    "identify": Command(
        "identify",
        (
            "tulip identify data/first",
            "tulip identify data/monday data/tuesday",
            "tulip identify data/first --tolerances encoder-offset=0.001",
        ),
        brief=True,
    ),
    "predict": Command("predict", ("tulip predict data/first", "tulip predict data/first --train 1-40")),
    "discover": Command(
        "discover", ("tulip discover data/first --out runs/found", "tulip discover data/monday data/tuesday")
    ),
    "plan random": Command(
        "draw_plan", ("tulip plan random --placements 10 --per-placement 5 --seed 7 --out plans/seven",)
    ),
    "plan optimal": Command(
        "optimize_plan", ("tulip plan optimal --out plans/best --seed 3 --objective condition",)
    ),
    "plan motion": Command(
        "plan_motion",
        (
            "tulip plan motion optimal --out plans/moving",
            "tulip plan motion random --minutes 20 --out plans/slow",
        ),
    ),
    "plan next": Command("next_experiment", ("tulip plan next runs/found --out plans/next",), saved=True),
    "plan show": Command("describe_plan", ("tulip plan show plans/best",)),
    "protocol": Command("protocol", ("tulip protocol optimal --sensors wii --out monday",)),
    "watch": Command(
        "watch",
        (
            "tulip watch lab/monday --plan random --out runs/monday.state --targets all=2",
            "tulip watch lab/monday --plan plans/next --json",
        ),
    ),
    "robot": Command(
        "describe_robot", ("tulip robot g1_29dof.urdf --out my/g1", "tulip robot my/g1/robot.toml")
    ),
    "import": Command(
        "import_table",
        ("tulip import standing.csv --robot my/robot/robot.toml --map contacts.toml --out data/standing",),
    ),
    "export": Command("export_model", ("tulip export runs/first --out identified.xml",)),
    "atlas": Command("atlas", ("tulip atlas --sensors force-plate --out atlas",)),
    "atlas effects": Command("list_effects", ("tulip atlas effects encoder-offset",)),
    "atlas tolerance": Command("tolerance", ("tulip atlas tolerance --sensors force-plate",)),
    "view": Command("view", ("tulip view runs/first",)),
    "report": Command(
        "report", ("tulip report runs/first --out first.html", "tulip report runs/first runs/second")
    ),
}
