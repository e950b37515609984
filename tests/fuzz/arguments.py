"""Unusual command lines, and what has to come of each."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.changes import EITHER, REFUSED, SAME, Change, Draw, Expected, one

COMMAND, DATA, PLAN, RUN, MADE = "command.json", "BASE/data", "BASE/plan", "BASE/run", "MADE/x"
IDENTIFY = ("identify", DATA, "--estimator", "least-squares", "--json")
SIMULATE = ("simulate", PLAN, "--engine", "statics", "--workers", "1", "--json", "--out", MADE)
MONTECARLO = ("montecarlo", PLAN, "--runs", "2", "--workers", "1", "--json", "--out", MADE)
RANDOM = ("plan", "random", "--placements", "6", "--per-placement", "5", "--json", "--out", MADE)
SEARCH = (
    "plan",
    "optimal",
    "--placements",
    "5",
    "--postures-per-placement",
    "6",
    "--hops",
    "0",
    "--json",
    "--out",
    MADE,
)
VALIDATE = ("validate", PLAN, "--workers", "1", "--json", "--out", MADE)
DISCOVER = ("discover", DATA, "--no-check", "--workers", "1", "--json", "--out", MADE)
REPORT = ("report", RUN, "--json", "--out", f"{MADE}.html")
COMPARE, CHECK, MODEL = ("report", RUN, RUN, "--json"), ("check", DATA, "--json"), ("robot", "--json")
EXPORT = ("export", RUN, "--json", "--out", f"{MADE}.xml")
PROTOCOL = ("protocol", PLAN, "--json", "--out", MADE)
WATCH, NEXT = (
    ("watch", DATA, "--plan", PLAN, "--once", "--json"),
    ("plan", "next", RUN, "--json", "--out", MADE),
)
EFFECTS, ATLAS = ("atlas", "effects", "--json"), ("atlas", PLAN, "--json")
TOLERANCE = ("atlas", "tolerance", PLAN, "--json")

Lines = Sequence[Sequence[str]]
HUGE = ("10000000000000", "9" * 30, "9" * 5_000)
NO_WHOLE = ("-1", "nan", "1.5", "1e3", "", "x", "inf", "0x1", "None", "[1]", "\x1b[31m", "1 2", "½", "-9" * 9)
NO_NUMBER = ("nan", "inf", "-inf", "-1", "1e400", "", "x", "1,5", "\x9b", "1 2", "0x1p3")
NO_NAMES = ("", " ", "nose", "wii ", "\x1b[2J", "[red]x", "x" * 10_000, "None", "\u202e", "a\nb", "*", "../x")
SEEDS = tuple((line, "--seed") for line in (SIMULATE, MONTECARLO, RANDOM, SEARCH, VALIDATE, DISCOVER))
SIZES = (
    *((MONTECARLO, "--runs"), (RANDOM, "--placements"), (RANDOM, "--per-placement"), (SEARCH, "--repeats")),
    *((SEARCH, "--placements"), (SEARCH, "--postures-per-placement"), (SEARCH, "--single-support")),
    *((SEARCH, "--right"), (SEARCH, "--left")),
)
WORKERS = tuple((line, "--workers") for line in (SIMULATE, MONTECARLO, VALIDATE, DISCOVER))
CHOICES = (
    *((line, "--sensors") for line in (SIMULATE, MONTECARLO, VALIDATE)),
    *((line, "--sensors") for line in (SEARCH, TOLERANCE, ATLAS)),
    *((line, "--estimator") for line in (IDENTIFY, MONTECARLO, VALIDATE)),
    *((MONTECARLO, "--engine"), (MONTECARLO, "--scheduler"), (SEARCH, "--objective"), (SEARCH, "--solver")),
    *((SIMULATE, "--effects"), (IDENTIFY, "--tolerances"), (DISCOVER, "--tolerances")),
)
EFFECT_TEXTS = (
    *("encoder-offset", "encoder-offset:right_knee", "encoder-offset:nose=0.01", "encoder-offset=0.01"),
    *(
        f"encoder-offset:right_knee={x}"
        for x in ("", "nan", "inf", "-inf", "1e400", "x", "1,2", "1e9", "=1", "1 2")
    ),
    *("cell-tare:right.nose=1", ":=", "=", ":", "cell-tare:=1", "swapped-cells:right=a,b", "tilt=1e300,1"),
)
TARGET_TEXTS = (
    "",
    "all",
    "all=",
    "=1",
    "nose=1",
    *(f"all={x}" for x in ("0", "-1", "nan", "inf", "x", "1e400")),
)
TOLERANCE_TEXTS = (
    "tilt",
    "tilt=",
    "=1",
    "magic=1",
    "tilt=nan",
    "tilt=-1",
    "tilt=1e400",
    "tilt=x",
    "tilt=1=2",
)
DESCRIBE, VIEW = ("plan", "show", PLAN, "--json"), ("view", RUN, "--save", f"{MADE}.rrd")
OF_A_ROBOT = (IDENTIFY, SIMULATE, MONTECARLO, MODEL, COMPARE, REPORT, CHECK, RANDOM, EXPORT, PROTOCOL, WATCH)
NAMED = (
    *((line, "--robot") for line in OF_A_ROBOT),
    *((line, "--corrections") for line in (IDENTIFY, SIMULATE, MONTECARLO, VALIDATE)),
    *((line, "--after") for line in (SEARCH, DESCRIBE)),
)
READ = (
    *((line, DATA) for line in (IDENTIFY, CHECK, DISCOVER, WATCH)),
    *((line, PLAN) for line in (SIMULATE, MONTECARLO, VALIDATE, TOLERANCE, ATLAS, DESCRIBE, PROTOCOL, WATCH)),
    *((line, RUN) for line in (COMPARE, REPORT, VIEW, EXPORT, NEXT)),
    *(((*line, option, "HERE"), "HERE") for line, option in NAMED),
)
NO_INPUTS = (
    *(
        "",
        "BASE/gone",
        "BASE",
        "BASE/empty",
        "BASE/pipe",
        "BASE/file",
        "BASE/loop",
        "/dev/zero",
        "/dev/tty",
        "/",
    ),
    *(
        "a\x00b",
        os.fsdecode(b"\xff"),
        "x" * 300,
        "x/" * 3_000,
        "BASE/file/x",
        "\x1b[2J",
        "~",
        "\n",
        "/proc/1/mem",
    ),
)
WRITTEN = (
    *((line, MADE) for line in (SIMULATE, MONTECARLO, RANDOM, SEARCH, VALIDATE, DISCOVER, PROTOCOL)),
    (EXPORT, f"{MADE}.xml"),
    ((*WATCH, "--out", "HERE"), "HERE"),
    *(((*SIMULATE, "--truth", "HERE"), "HERE"), ((*ATLAS, "--out", "HERE"), "HERE")),
    *((REPORT, f"{MADE}.html"), (("view", RUN, "--save", f"{MADE}.rrd"), f"{MADE}.rrd")),
    (("plan", "show", PLAN, "--json", "--draw", "HERE"), "HERE"),
)
NO_OUTPUTS = (
    *(
        "",
        "BASE",
        "BASE/empty",
        "BASE/file",
        "BASE/file/x",
        "BASE/pipe",
        "BASE/loop",
        "BASE/loop/x",
        "/",
        ".",
    ),
    *("..", "/dev/null", "/proc/x", "/sys/x", "a\x00b", os.fsdecode(b"\xff"), "x" * 300, "MADE/" + "y" * 300),
)
CONFLICTS: Lines = (
    (*SEARCH, "--table1", "--after", DATA),
    (*SEARCH, "--solver", "ipopt", "--after", DATA),
    (*SEARCH, "--repeats", "31"),
    ("view", RUN, "--save", "MADE/x.rrd", "--serve"),
    (*SIMULATE, "--truth", f"{MADE}/truth.json"),
    (*SIMULATE, "--truth", MADE),
    (*SIMULATE, "--truth", "MADE"),
    (*MONTECARLO, "--sensors", "ideal"),
    (*MONTECARLO, "--scheduler", "127.0.0.1"),
    (*MONTECARLO, "--robot-spread", "0.1", "--corrections", "BASE/gone"),
    ("montecarlo", PLAN, "--out", MADE),
    ("simulate", PLAN),
    ("report", RUN),
    ("report", RUN, DATA),
    ("report", RUN, RUN, RUN),
    ("identify",),
    ("identify", DATA, DATA),
    ("identify", RUN),
    ("report", DATA, "--out", "MADE/x.html"),
    ("report", RUN, "--out", "MADE/x.txt"),
    ("simulate", DATA, "--out", MADE),
    ("check", PLAN),
    *(("watch", DATA), ("watch", DATA, "--plan", DATA, "--once"), ("watch", PLAN, "--plan", PLAN, "--once")),
    (*WATCH, "--out", f"{DATA}/state"),
    *(("protocol", PLAN), ("protocol", DATA, "--out", MADE), ("protocol", RUN, "--out", MADE)),
    *(("export", RUN), ("export", PLAN, "--out", f"{MADE}.xml"), ("export", RUN, "--out", f"{MADE}.txt")),
    *(("plan", "next", DATA), ("plan", "next", PLAN), ("plan", "next", RUN)),
)
UNKNOWN = (
    "--nose",
    "--sed",
    "-x",
    "--json=1",
    "--seed",
    "nose",
    "",
    "--\x1b[2J",
    "--[red]",
    "\u202e",
    "--no-no",
)
ALIKE: Lines = (
    ("identify", "--json", "--estimator", "least-squares", DATA),
    ("identify", DATA, "--estimator=least-squares", "--json"),
    ("identify", "BASE/../base/./data/", "--estimator", "least-squares", "--json"),
    ("identify", DATA, "--estimator", "robust", "--estimator", "least-squares", "--json"),
    (*IDENTIFY, "--no-json", "--json"),
)
HELP: Lines = (
    (),
    ("--help",),
    ("-h",),
    ("--version",),
    ("",),
    ("nose",),
    ("identify", "--help"),
    ("\x1b[2J",),
)


def line(expected: Expected, lines: Lines) -> Change:
    """Give one of the command lines."""

    def change(folder: Path, draw: Draw) -> Expected:
        (folder / "empty").mkdir()
        (folder / "file").write_text("x")
        os.mkfifo(folder / "pipe")
        (folder / "loop").symlink_to(folder / "loop")
        made = folder.with_name("made")
        made.mkdir()
        words = [word.replace("BASE", str(folder)).replace("MADE", str(made)) for word in one(draw, lines)]
        (folder / COMMAND).write_text(json.dumps(words))
        return expected

    return change


def with_value(options: Sequence[tuple[Sequence[str], str]], values: Sequence[str]) -> Lines:
    return [(*line, option, value) for line, option in options for value in values]


def instead(places: Sequence[tuple[Sequence[str], str]], values: Sequence[str]) -> Lines:
    return [[value if word == old else word for word in line] for line, old in places for value in values]


ALL = (
    IDENTIFY,
    SIMULATE,
    MONTECARLO,
    RANDOM,
    SEARCH,
    VALIDATE,
    DISCOVER,
    REPORT,
    COMPARE,
    CHECK,
    MODEL,
    EFFECTS,
    EXPORT,
    PROTOCOL,
    WATCH,
    NEXT,
)
ARGUMENT_KINDS: dict[str, Change] = {
    "seeds": line(
        REFUSED,  # random postures without a seed are what they are by default
        [given for given in with_value(SEEDS, NO_WHOLE) if given != (*RANDOM, "--seed", "None")],
    ),
    "large seeds": line(EITHER, with_value(SEEDS[:3], HUGE)),
    "sizes": line(REFUSED, with_value(SIZES, NO_WHOLE)),
    "large sizes": line(REFUSED, with_value(SIZES, HUGE)),
    "no workers": line(REFUSED, with_value(WORKERS, ("0", *NO_WHOLE))),
    "many workers": line(EITHER, with_value(WORKERS[:2], HUGE)),
    "imperfections": line(
        REFUSED, with_value([(SIMULATE, "--imperfections"), (MONTECARLO, "--imperfections")], NO_NUMBER)
    ),
    "robot spread": line(
        REFUSED, with_value([(MONTECARLO, "--robot-spread")], (*NO_NUMBER, "0", "2", "1e-400"))
    ),
    "no choices": line(REFUSED, with_value(CHOICES, NO_NAMES)),
    "no effects": line(REFUSED, with_value([(SIMULATE, "--effects")], EFFECT_TEXTS)),
    "no tolerances": line(
        REFUSED, with_value([(IDENTIFY, "--tolerances"), (DISCOVER, "--tolerances")], TOLERANCE_TEXTS)
    ),
    "no targets": line(REFUSED, with_value([(WATCH, "--targets")], TARGET_TEXTS)),
    "no samples": line(REFUSED, with_value([(EXPORT, "--samples")], NO_WHOLE)),
    "no inputs": line(REFUSED, instead(READ, NO_INPUTS)),
    "no outputs": line(REFUSED, instead(WRITTEN, NO_OUTPUTS)),
    "conflicts": line(REFUSED, CONFLICTS),
    "unknown words": line(REFUSED, [(*given, word) for given in ALL for word in UNKNOWN]),
    "the same otherwise": line(SAME, ALIKE),
    "help": line(EITHER, HELP),
    "no subject of an explanation": line(
        REFUSED, [("atlas", "effects", name) for name in NO_NAMES if name != "None"]
    ),
}
