"""Unusual command lines, and what has to come of each."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.changes import EITHER, REFUSED, SAME, Change, Draw, Expected, one

Line = tuple[str, ...]
COMMAND, DATA, PLAN, RUN, MADE = "command.json", "BASE/data", "BASE/plan", "BASE/run", "MADE/x"


def words(text: str, **names: str) -> Line:
    return tuple(text.format(data=DATA, plan=PLAN, run=RUN, out=f"--json --out {MADE}", **names).split())


LINES = {
    name: words(text)
    for name, text in {
        "identify": "identify {data} --estimator least-squares --json",
        "simulate": "simulate {plan} --engine statics --workers 1 {out}",
        "montecarlo": "montecarlo {plan} --runs 2 --workers 1 {out}",
        "random": "plan random --placements 6 --per-placement 5 {out}",
        "search": "plan optimal --placements 5 --postures-per-placement 6 --hops 0 {out}",
        "validate": "validate {plan} --workers 1 {out}",
        "discover": "discover {data} --no-check --workers 1 {out}",
        "report": "report {run} {out}.html",
        "compare": "report {run} {run} --json",
        "check": "check {data} --json",
        "robot": "robot --json",
        "effects": "atlas effects --json",
        "export": "export {run} {out}.xml",
        "protocol": "protocol {plan} {out}",
        "watch": "watch {data} --plan {plan} --once --json",
        "next": "plan next {run} {out}",
        "atlas": "atlas {plan} --json",
        "tolerance": "atlas tolerance {plan} --json",
        "show": "plan show {plan} --json",
        "view": "view {run} --save MADE/x.rrd",
    }.items()
}
HUGE = ("10000000000000", "9" * 30, "9" * 5_000)
NO_WHOLE = ("-1", "nan", "1.5", "1e3", "", "x", "inf", "0x1", "None", "[1]", "\x1b[31m", "1 2", "½", "-9" * 9)
NO_NUMBER = ("nan", "inf", "-inf", "-1", "1e400", "", "x", "1,5", "\x9b", "1 2", "0x1p3")
NO_NAMES = ("", " ", "nose", "wii ", "\x1b[2J", "[red]x", "x" * 10_000, "None", "\u202e", "a\nb", "*", "../x")
VALUES = ("", "nan", "inf", "-inf", "1e400", "x", "1,2", "1e9", "=1", "1 2")
KNEE = [f"encoder-offset:right_knee={value}" for value in VALUES]
EFFECT_TEXTS = (
    *words("encoder-offset encoder-offset:right_knee encoder-offset:nose=0.01 encoder-offset=0.01"),
    *words("cell-tare:right.nose=1 := = : cell-tare:=1 swapped-cells:right=a,b tilt=1e300,1"),
    *KNEE,
)
TARGET_TEXTS = ("", *words("all all= =1 nose=1 all=0 all=-1 all=nan all=inf all=x all=1e400"))
TOLERANCE_TEXTS = words("tilt tilt= =1 magic=1 tilt=nan tilt=-1 tilt=1e400 tilt=x tilt=1=2")
UNKNOWN = (*words("--nose --sed -x --json=1 --seed nose --[red] --no-no"), "", "--\x1b[2J", "\u202e")
NOT_UTF_8 = os.fsdecode(b"\xff")
NO_INPUTS = (
    *("", "a\x00b", NOT_UTF_8, "x" * 300, "x/" * 3_000, "\x1b[2J", "~", "\n"),
    *words("BASE/gone BASE BASE/empty BASE/pipe BASE/file BASE/loop BASE/file/x"),
    *words("/dev/zero /dev/tty / /proc/1/mem"),
)
NO_OUTPUTS = (
    *("", "a\x00b", NOT_UTF_8, "x" * 300, "MADE/" + "y" * 300),
    *words("BASE BASE/empty BASE/file BASE/file/x BASE/pipe BASE/loop BASE/loop/x"),
    *words("/ . .. /dev/null /proc/x /sys/x"),
)


def options(text: str) -> list[tuple[Line, str]]:
    """Read `OPTION: COMMAND COMMAND`, a line each."""
    pairs = [line.split(": ") for line in text.strip().splitlines()]
    return [(LINES[name], f"--{option}") for option, names in pairs for name in names.split()]


def with_value(text: str, values: Sequence[str]) -> list[Line]:
    return [(*line, option, value) for line, option in options(text) for value in values]


def instead(places: Sequence[tuple[Line, str]], values: Sequence[str]) -> list[Line]:
    return [tuple(new if word == old else word for word in line) for line, old in places for new in values]


SEEDS = "seed: simulate montecarlo random search validate discover"
SIZES = """
runs: montecarlo
placements: random search
per-placement: random
repeats: search
postures-per-placement: search
right: search
left: search
"""
CHOICES = """
sensors: simulate montecarlo validate search tolerance atlas
estimator: identify montecarlo validate
engine: montecarlo
scheduler: montecarlo
objective: search
effects: simulate
tolerances: identify discover
"""
NAMED = """
robot: identify simulate montecarlo robot compare report check random export protocol watch
corrections: identify simulate montecarlo validate
after: search show
"""
READ = {
    DATA: "identify check discover watch",
    PLAN: "simulate montecarlo validate tolerance atlas show protocol watch",
    RUN: "compare report view export next",
}
WRITTEN = {
    MADE: "simulate montecarlo random search validate discover protocol",
    f"{MADE}.xml": "export",
    f"{MADE}.html": "report",
    f"{MADE}.rrd": "view",
}
HERE = {"watch": "--out", "simulate": "--truth", "atlas": "--out", "show": "--draw"}
INPUTS = [(LINES[name], place) for place, names in READ.items() for name in names.split()]
INPUTS += [((*line, option, "HERE"), "HERE") for line, option in options(NAMED)]
OUTPUTS = [(LINES[name], place) for place, names in WRITTEN.items() for name in names.split()]
OUTPUTS += [((*LINES[name], option, "HERE"), "HERE") for name, option in HERE.items()]
ALIKE = """
identify --json --estimator least-squares {data}
identify {data} --estimator=least-squares --json
identify BASE/../base/./data/ --estimator least-squares --json
identify {data} --estimator robust --estimator least-squares --json
{identify} --no-json --json
"""
HELP: list[Line] = [(), ("",), ("\x1b[2J",), ("identify", "--help")]
HELP += [(word,) for word in words("--help -h --version nose")]


def lines(text: str) -> list[Line]:
    """Read command lines in which `{name}` stands for one of those above."""
    names = {name: " ".join(line) for name, line in LINES.items()}
    return [words(line, **names) for line in text.strip().splitlines()]


def line(expected: Expected, given: Sequence[Line]) -> Change:
    """Give one of the command lines."""

    def change(folder: Path, draw: Draw) -> Expected:
        (folder / "empty").mkdir()
        (folder / "file").write_text("x")
        os.mkfifo(folder / "pipe")
        (folder / "loop").symlink_to(folder / "loop")
        made = folder.with_name("made")
        made.mkdir()
        chosen = [word.replace("BASE", str(folder)).replace("MADE", str(made)) for word in one(draw, given)]
        (folder / COMMAND).write_text(json.dumps(chosen))
        return expected

    return change


WORKERS = "workers: simulate montecarlo validate discover"
ALL = [given for name, given in LINES.items() if name not in ("atlas", "tolerance", "show", "view")]
ARGUMENT_KINDS: dict[str, Change] = {
    "seeds": line(
        REFUSED,  # random postures without a seed are what they are by default
        [given for given in with_value(SEEDS, NO_WHOLE) if given != (*LINES["random"], "--seed", "None")],
    ),
    "large seeds": line(EITHER, with_value("seed: simulate montecarlo random", HUGE)),
    "sizes": line(REFUSED, with_value(SIZES, NO_WHOLE)),
    "large sizes": line(REFUSED, with_value(SIZES, HUGE)),
    "no workers": line(REFUSED, with_value(WORKERS, ("0", *NO_WHOLE))),
    "many workers": line(EITHER, with_value("workers: simulate montecarlo", HUGE)),
    "imperfections": line(REFUSED, with_value("imperfections: simulate montecarlo", NO_NUMBER)),
    "robot spread": line(REFUSED, with_value("robot-spread: montecarlo", (*NO_NUMBER, "0", "2", "1e-400"))),
    "no choices": line(REFUSED, with_value(CHOICES, NO_NAMES)),
    "no effects": line(REFUSED, with_value("effects: simulate", EFFECT_TEXTS)),
    "no tolerances": line(REFUSED, with_value("tolerances: identify discover", TOLERANCE_TEXTS)),
    "no targets": line(REFUSED, with_value("targets: watch", TARGET_TEXTS)),
    "no samples": line(REFUSED, with_value("samples: export", NO_WHOLE)),
    "no inputs": line(REFUSED, instead(INPUTS, NO_INPUTS)),
    "no outputs": line(REFUSED, instead(OUTPUTS, NO_OUTPUTS)),
    "unknown words": line(REFUSED, [(*given, word) for given in ALL for word in UNKNOWN]),
    "the same otherwise": line(SAME, lines(ALIKE)),
    "help": line(EITHER, HELP),
    "no subject of an explanation": line(
        REFUSED, [("atlas", "effects", name) for name in NO_NAMES if name != "None"]
    ),
}
