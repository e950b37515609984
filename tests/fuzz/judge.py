"""Does an input end in a right result, or in one message with exit code 2 and nothing left behind?"""

from __future__ import annotations

import codecs
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.fuzz.changes import Draw, Expected
from tests.fuzz.readings import on_page, reading, result, text_of
from tests.fuzz.records import CHUNK
from tests.fuzz.targets import KINDS, ON_PAGES, PAGES, Intact, commands
from tulip_testbed.cli.main import main
from tulip_testbed.sim.robot import load_robot

SECONDS, MEMORY = (
    240,
    3 * 2**30,
)  # of one command [s]; of the process that runs them, half of it libraries [bytes]
NOBODY = 65534
NOTE = re.compile(r"((Run|Plan|Measurement) folder|Report|View|Atlas|Left out): ")
MANY_ROWS = "too many rows"  # a watch judges each of them, for minutes
JUDGING = ("montecarlo", "validate", "check")  # commands whose exit code 1 is a verdict
TOLERANCE = 1e-6  # of a result, relative to its largest number
MAY_BE_NULL = (
    "calibration",
    "standard",
    "unseen",
    "made",
    "rig",
    "relative_standard_error",
    "predicted_relative_standard_error_percent",
    "found",
    "description",
    "complaints",
    "example_manifest",
    "example_row",
)


class Run(NamedTuple):
    """What a command did; the code is 70 after a traceback."""

    code: int
    out: str
    err: str


def limit() -> None:
    """Prepare the process that runs the commands."""
    warnings.simplefilter("error")
    for late in (
        "typeguard",
        "tulip_testbed.api",
        "tulip_testbed.cli.terminal",
    ):  # when a case may run as one who cannot read them
        import_module(late)
    codecs.lookup("utf-8-sig")
    _ = load_robot().model  # its trial in a process of its own, with an interpreter that others may not use
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, resource.getrlimit(resource.RLIMIT_DATA)[1]))


def call(arguments: list[str], where: Path, nobody: bool) -> Run:
    """Run a command in this process, which ends if that takes too long; catch what C libraries print too."""
    os.chdir(where)
    signal.alarm(SECONDS)
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        try:
            if nobody and os.getuid() == 0:  # for root every file is readable
                os.seteuid(NOBODY)
            code = main(arguments)
        except SystemExit as end:  # of the parser of arguments
            code = end.code if isinstance(end.code, int) else 70
        except BaseException:
            traceback.print_exc()
            code = 70
        os.seteuid(os.getuid())
        sys.stdout.flush()
        sys.stderr.flush()
        texts = [os.pread(file.fileno(), 10_000_000, 0).decode("utf-8", "replace") for file in (out, err)]
    signal.alarm(0)
    os.chdir("/")
    notes = [line for line in texts[1].split("\n") if not NOTE.match(line)]
    return Run(code, texts[0], "\n".join(notes))


class Judge:
    """The intact inputs, their results, and the process that runs the commands.

    Args:
        place: an empty folder for the intact inputs.
        brief: run only the first command that reads an input.
    """

    def __init__(self, place: Path, brief: bool) -> None:
        self.brief, self.place = brief, place
        self.results: dict[str, Any] = {}
        self._start()
        self.intact = Intact(place, lambda arguments: self.tulip(arguments, place), brief)

    def _start(self) -> None:
        # Its memory is limited, so it does not live long enough to fill up.
        self.pool = ProcessPoolExecutor(1, get_context("spawn"), limit, max_tasks_per_child=50)

    def tulip(self, arguments: list[str], where: Path, nobody: bool = False) -> Run:
        """Run a command in the other process.

        Raises:
            AssertionError: it crashed or hung.
        """
        try:
            return self.pool.submit(call, arguments, where, nobody).result()
        except BrokenProcessPool:
            self._start()
            raise AssertionError(f"crashed, or took more than {SECONDS} s: {arguments}") from None

    def result(self, target: str) -> Any:
        """Return the document that comes of the intact input."""
        if target not in self.results:
            with tempfile.TemporaryDirectory() as place:
                folder = self._copy(target, Path(place))
                (first, *_) = commands(target, folder, Path(place) / "made", self.intact)
                self.results[target] = json.loads(self.tulip(first, self.place).out)
        return self.results[target]

    def _copy(self, target: str, home: Path) -> Path:
        """Copy the intact input, and beside a rig the measurements that it is tried on."""
        if target == "rig":
            shutil.copytree(self.intact("measurements"), home / "data")
        return Path(shutil.copytree(self.intact(target), home / "base"))

    def message(self, target: str, kind: str, draw: Draw) -> str:
        """Make an input of a kind, run the commands, and return the refusal; nothing if it was accepted.

        Raises:
            AssertionError: it ended otherwise.
        """
        with tempfile.TemporaryDirectory() as place:
            home, here, made = Path(place), Path(place) / "here", Path(place) / "made"
            home.chmod(0o755)
            here.mkdir()
            folder = self._copy(target, home)
            expected = KINDS[target][kind](folder, draw)
            there, nobody, runs = set(home.rglob("*")), kind.startswith("closed"), []
            given = commands(target, folder, made, self.intact)
            if target in PAGES and any(words in kind for words in ON_PAGES):
                given.append(["report", str(folder), "--out", str(made / "page.html")])
            for arguments in given[: 1 if self.brief else None]:
                runs.append(self.tulip(arguments, here, nobody))
                check_output(runs[-1], arguments)
                if runs[-1].code > (arguments[:1] in [[name] for name in JUDGING]):
                    break
            refused = runs[-1].code > (given[len(runs) - 1][:1] in [[name] for name in JUDGING])
            if target == "measurements" and not self.brief:
                check_preflight(self.tulip(["check", str(folder), "--json"], here, nobody), runs[-1])
                if kind != MANY_ROWS:
                    watch = ["watch", str(folder), "--plan", str(self.intact("plan")), "--once", "--json"]
                    check_watch(self.tulip(watch, here, nobody))
            check_left(home, there | {folder / CHUNK})
            if refused:
                return check_refusal(runs[-1], expected, home, target)
            if target == "arguments" and expected.outcome == "either":
                return ""
            before = self.result(target) if expected.outcome == "same" else None
            check_result(json.loads(runs[0].out), expected, target, folder, before)
            if (page := made / "page.html").exists():
                check_page(page, target, folder)
            return ""


def check_output(run: Run, arguments: list[str]) -> None:
    """Check that nothing steers a terminal, and that nothing is said beside a result but a doubt."""
    signs = {sign for sign in run.out + run.err if not sign.isprintable() and sign != "\n"}
    assert not signs, f"control characters {signs}: {arguments}, {run}"
    assert run.code > 1 or not without_doubts(run.err), run


def without_doubts(said: str) -> str:
    """Return what was said beside warnings: a doubt may stand beside a result and before a refusal."""
    return "".join(line for line in said.splitlines(True) if not line.startswith("tulip: warning: "))


def check_left(home: Path, there: set[Path]) -> None:
    """Check that nothing was left behind but what a command was to make."""
    new = set(home.rglob("*")) - there
    left = [path for path in new if "made" not in path.parts or path.name.endswith(".partial")]
    assert not left, f"left behind: {left}"


def check_preflight(checked: Run, identified: Run) -> None:
    """Check that a preflight reads what identify can; it may judge more strictly."""
    assert checked.code in (0, 1, 2), checked
    assert checked.err.count("\n") <= (checked.code == 2), checked
    assert not checked.out or isinstance(json.loads(checked.out), dict)
    assert identified.code or checked.code < 2, f"it cannot read what identify can: {checked}"


def check_watch(watched: Run) -> None:
    """Check that a watch judges rows or says what is wrong; it may read more than others do."""
    assert watched.code in (0, 2), watched
    for text in watched.out.splitlines():
        assert {"posture", "verdict", "next", "stop"} <= set(json.loads(text)), text
    if watched.code == 2:
        refusals = [text for text in watched.err.splitlines() if text.startswith("tulip: ")]
        assert refusals, watched.err


def check_refusal(run: Run, expected: Expected, home: Path, target: str) -> str:
    """Check that a refusal is one message that names a place or an option, and return it."""
    assert (run.code, run.out) == (2, ""), run
    assert expected.outcome in ("refused", "either"), run.err
    assert [word for word in expected.words if word not in run.err] == [], run.err
    if target == "arguments":
        assert run.err.startswith(("tulip: ", "\u256d")), run.err
        return run.err
    refusal = without_doubts(run.err)
    assert refusal.startswith("tulip: "), run.err
    assert refusal.count("\n") == 1, run.err
    assert len(run.err) <= 3_000, run.err
    # That no posture could be held is a finding, not a fault of one file.
    assert any(sign in refusal for sign in (str(home), "--", "postures could be measured")), run.err
    return refusal


def check_result(document: Any, expected: Expected, target: str, folder: Path, before: Any) -> None:
    """Check that a result is complete and agrees with the intact input's or with an independent reading."""
    assert expected.outcome != "refused", "accepted"
    assert target in (*PAGES, "resume") or not unknown(document), "a result that is no number"
    wanted = result(target, before) if expected.outcome == "same" else reading(target, folder)
    for name, found in result(target, document).items():
        check_alike(found, wanted[name], name)


def check_alike(found: Any, right: Any, name: str) -> None:
    """Compare numbers within `TOLERANCE`, everything else exactly."""
    try:
        numbers, rights = np.asarray(found, float), np.asarray(right, float)
    except (TypeError, ValueError):
        assert found == right, f"{name}: found {found}, expected {right}"
        return
    most = TOLERANCE * max(np.nan_to_num(np.abs(rights)).max(initial=0.0), 1e-9)
    np.testing.assert_allclose(numbers, rights, rtol=0, atol=most, err_msg=name)


def check_page(page: Path, target: str, folder: Path) -> None:
    """Check that a page says what the files hold."""
    text = text_of(page.read_text("utf-8"))
    signs = {sign for sign in text if not sign.isprintable()}
    assert not signs, f"control characters on the page: {signs}"
    missing = [words for words in on_page(target, folder) if words not in text]
    assert not missing, f"not on the page: {missing}"


def unknown(value: Any) -> bool:
    """Return whether a document holds a null where a number was computed."""
    if isinstance(value, dict):
        value = [inner for key, inner in value.items() if key not in MAY_BE_NULL]
    return any(map(unknown, value)) if isinstance(value, list) else value is None
