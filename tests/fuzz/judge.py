"""Does an input end in a right result, or in one message with exit code 2 and nothing left behind?"""

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

from tests.fuzz.changes import Change, Draw, Expected
from tests.fuzz.folders import MEASUREMENT_KINDS, PLAN_KINDS
from tests.fuzz.readings import reading, result
from tests.fuzz.robots import ROBOT_KINDS
from tulip_testbed.cli.main import main
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.shipped import ASSETS

SECONDS = 240  # of one command
MEMORY = 3 * 2**30  # bytes of the process that runs them, half of it libraries
NOBODY = 65534
NOTE = re.compile(r"((Run|Plan|Measurement) folder|Report|View|Atlas|Left out): ")
TOLERANCE = 1e-6  # of a result, relative to its largest number
MAY_BE_NULL = (
    *("calibration", "standard", "data_share", "direction_shares", "cad_scales", "unseen", "made", "rig"),
    *("found", "description", "complaints", "example_manifest", "example_row", "low95", "high95"),
    *("relative_standard_error", "predicted_relative_standard_error_percent"),
)


KINDS: dict[str, dict[str, Change]] = {
    "measurements": MEASUREMENT_KINDS,
    "plan": PLAN_KINDS,
    "robot": ROBOT_KINDS,
}


MAKE = {
    "plan": "plan random --placements 6 --per-placement 5 --seed 107 --out plan",
    "measurements": "simulate plan --engine statics --workers 1 --out measurements",
}  # the inputs that nothing is wrong with


def command(target: str, folder: Path) -> list[str]:
    """Return the command that reads an input."""
    base = str(folder)
    if target == "robot":
        return ["robot", f"{base}/tulip.toml", "--json"]
    if target == "plan":
        return ["plan", "show", base, "--json"]
    return ["identify", base, "--estimator", "least-squares", "--json"]  # an independent reading solves eq. 8


class Run(NamedTuple):
    """What a command did; the code is 70 after a traceback."""

    code: int
    out: str
    err: str


def limit() -> None:
    """Prepare the process that runs the commands."""
    warnings.simplefilter("error")
    # When a case may run as one who cannot read them.
    for late in ("typeguard", "tulip_testbed.api", "tulip_testbed.cli.terminal"):
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
    """

    def __init__(self, place: Path) -> None:
        self.place = place
        self.results: dict[str, Any] = {}
        self._start()
        for line in MAKE.values():
            self.tulip(line.split(), place)

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
                done = self.tulip(command(target, folder), self.place)
                self.results[target] = json.loads(done.out)
        return self.results[target]

    def _copy(self, target: str, home: Path) -> Path:
        intact = ASSETS / "tulip_mjcf" if target == "robot" else self.place / target
        return Path(shutil.copytree(intact, home / "base"))

    def message(self, target: str, kind: str, draw: Draw) -> str:
        """Make an input of a kind, run the command, and return the refusal; nothing if it was accepted.

        Raises:
            AssertionError: it ended otherwise.
        """
        with tempfile.TemporaryDirectory() as place:
            home, here = Path(place), Path(place) / "here"
            home.chmod(0o755)
            here.mkdir()
            folder = self._copy(target, home)
            expected = KINDS[target][kind](folder, draw)
            there = set(home.rglob("*"))
            arguments = command(target, folder)
            run = self.tulip(arguments, here, nobody=kind.startswith("closed"))
            check_output(run, arguments)
            left = set(home.rglob("*")) - there
            assert not left, f"left behind: {left}"
            if run.code:
                return check_refusal(run, expected, home)
            before = self.result(target) if expected.outcome == "same" else None
            check_result(json.loads(run.out), expected, target, folder, before)
            return ""


def check_output(run: Run, arguments: list[str]) -> None:
    """Check that nothing steers a terminal, and that nothing is said beside a result but a doubt."""
    signs = {sign for sign in run.out + run.err if not sign.isprintable() and sign != "\n"}
    assert not signs, f"control characters {signs}: {arguments}, {run}"
    assert run.code > 1 or not without_doubts(run.err), run


def without_doubts(said: str) -> str:
    """Return what was said beside warnings: a doubt may stand beside a result and before a refusal."""
    return "".join(line for line in said.splitlines(True) if not line.startswith("tulip: warning: "))


def check_refusal(run: Run, expected: Expected, home: Path) -> str:
    """Check that a refusal is one message that names a place, and return it."""
    assert (run.code, run.out) == (2, ""), run
    assert expected.outcome in ("refused", "either"), run.err
    assert [word for word in expected.words if word not in run.err] == [], run.err
    refusal = without_doubts(run.err)
    assert refusal.startswith("tulip: "), run.err
    assert refusal.count("\n") == 1, run.err
    assert len(run.err) <= 3_000, run.err
    # That no posture could be held is a finding, not a fault of one file.
    parameter = re.match(r"tulip: \w+(, \w+)*( [^:]*)?: ", refusal)
    assert parameter or str(home) in refusal or "postures could be measured" in refusal, run.err
    return refusal


def check_result(document: Any, expected: Expected, target: str, folder: Path, before: Any) -> None:
    """Check that a result is complete and agrees with the intact input's or with an independent reading."""
    assert expected.outcome != "refused", "accepted"
    assert not unknown(document), "a result that is no number"
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


def unknown(value: Any) -> bool:
    """Return whether a document holds a null where a number was computed."""
    if isinstance(value, dict):
        value = [inner for key, inner in value.items() if key not in MAY_BE_NULL]
    return any(map(unknown, value)) if isinstance(value, list) else value is None
