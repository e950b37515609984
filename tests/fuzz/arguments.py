"""Unusual command lines, and what has to come of each."""

from __future__ import annotations

import json
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


def with_value(text: str, values: Sequence[str]) -> list[Line]:
    """Give `OPTION: COMMAND COMMAND; OPTION: ...` each of the values."""
    pairs = [part.split(": ") for part in text.split("; ")]
    return [
        (*LINES[name], f"--{option}", value)
        for option, names in pairs
        for name in names.split()
        for value in values
    ]


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
        made = folder.with_name("made")
        made.mkdir()
        chosen = [word.replace("BASE", str(folder)).replace("MADE", str(made)) for word in one(draw, given)]
        (folder / COMMAND).write_text(json.dumps(chosen))
        return expected

    return change


SIZES = "runs: montecarlo; placements: random search; per-placement: random; right: search; left: search; "
SIZES += "repeats: search; postures-per-placement: search"
CHOICES = (
    "sensors: simulate montecarlo validate search tolerance atlas; estimator: identify montecarlo validate; "
)
CHOICES += "engine: montecarlo; scheduler: montecarlo; objective: search; effects: simulate; "
CHOICES += "tolerances: identify discover"
ALL = [given for name, given in LINES.items() if name not in ("atlas", "tolerance", "show", "view")]
OPTIONS: dict[str, tuple[Expected, str, Sequence[str]]] = {
    "seeds": (REFUSED, "seed: simulate montecarlo search validate discover", NO_WHOLE),
    "large seeds": (EITHER, "seed: simulate montecarlo random", HUGE),
    "sizes": (REFUSED, SIZES, NO_WHOLE),
    "large sizes": (REFUSED, SIZES, HUGE),
    "no workers": (REFUSED, "workers: simulate montecarlo validate discover", ("0", *NO_WHOLE)),
    "many workers": (EITHER, "workers: simulate montecarlo", HUGE),
    "imperfections": (REFUSED, "imperfections: simulate montecarlo", NO_NUMBER),
    "robot spread": (REFUSED, "robot-spread: montecarlo", (*NO_NUMBER, "0", "2", "1e-400")),
    "no choices": (REFUSED, CHOICES, NO_NAMES),
    "no effects": (REFUSED, "effects: simulate", EFFECT_TEXTS),
    "no tolerances": (REFUSED, "tolerances: identify discover", TOLERANCE_TEXTS),
    "no targets": (REFUSED, "targets: watch", TARGET_TEXTS),
    "no samples": (REFUSED, "samples: export", NO_WHOLE),
}
ARGUMENT_KINDS: dict[str, Change] = {
    **{kind: line(expected, with_value(text, values)) for kind, (expected, text, values) in OPTIONS.items()},
    "unknown words": line(REFUSED, [(*given, word) for given in ALL for word in UNKNOWN]),
    "the same otherwise": line(SAME, lines(ALIKE)),
    "help": line(EITHER, HELP),
    "no effect": line(REFUSED, [("atlas", "effects", name) for name in NO_NAMES if name != "None"]),
}
