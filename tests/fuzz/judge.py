"""Does an input end in a right result, or in one message with exit code 2 and nothing left behind?"""

from __future__ import annotations

import itertools
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
import xml.etree.ElementTree as ET
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tests.fuzz.changes import Draw, Expected
from tests.fuzz.folders import MEASUREMENT_KINDS, PLAN_KINDS
from tests.fuzz.robots import PLATE_KINDS, ROBOT_KINDS
from tulip_testbed.cli.main import main
from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.sim.robot import CORNERS, PLATES, load_robot
from tulip_testbed.sim.shipped import ASSETS

KINDS = {"measurements": MEASUREMENT_KINDS, "plan": PLAN_KINDS, "robot": ROBOT_KINDS | PLATE_KINDS}
SECONDS, MEMORY = 240, 2**31  # of one command [s]; of the process that runs them [bytes]
NOBODY = 65534
TOLERANCE = 1e-6  # of a result, relative to its largest number
MAY_BE_NULL = ("truth", "made", "rig", "relative_standard_error", "predicted_relative_standard_error_percent")


class Run(NamedTuple):
    """What a command did; the code is 70 after a traceback."""

    code: int
    out: str
    err: str


def limit() -> None:
    """Prepare the process that runs the commands."""
    warnings.simplefilter("error")
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
        except BaseException:
            traceback.print_exc()
            code = 70
        os.seteuid(os.getuid())
        sys.stdout.flush()
        sys.stderr.flush()
        texts = [os.pread(file.fileno(), 10_000_000, 0).decode("utf-8", "replace") for file in (out, err)]
    signal.alarm(0)
    os.chdir("/")
    return Run(code, texts[0], "".join(line for line in texts[1].splitlines(True) if "folder: /" not in line))


def commands(target: str, folder: Path, made: Path) -> list[list[str]]:
    """Return the commands that read an input; each is run if those before it succeed."""
    base, robot = str(folder), ["--robot", str(folder / "tulip.toml")]
    plan, few = str(made / "plan"), ["--placements", "3", "--per-placement", "5", "--seed", "107"]
    if target == "measurements":  # the independent reading solves eq. 8
        return [["identify", base, "--estimator", "least-squares", "--json"], ["identify", base]]
    if target == "plan":
        return [["postures", base, "--json"], ["postures", base]]
    return [
        *(["model", *robot, "--json"], ["model", *robot]),
        ["postures", "--random", "--out", plan, *few, *robot],
        ["simulate", plan, "--out", str(made / "data"), "--workers", "1", "--preset", "ideal", *robot],
    ]


class Judge:
    """The intact inputs, their results, and the process that runs the commands.

    Args:
        place: an empty folder for a plan and its measurements; the robot is the shipped one.
        brief: run only the first command that reads an input.
    """

    def __init__(self, place: Path, brief: bool) -> None:
        self.brief, self.results = brief, {}
        self.intact = {"plan": place / "plan", "measurements": place / "data", "robot": ASSETS / "tulip_mjcf"}
        self._start()
        plan, shape = str(place / "plan"), ["--placements", "6", "--per-placement", "5", "--seed", "107"]
        self.tulip(["postures", "--random", "--out", plan, *shape], place)
        self.tulip(["simulate", plan, "--statics", "--workers", "1", "--out", str(place / "data")], place)
        for target, folder in self.intact.items():
            self.results[target] = json.loads(self.tulip(commands(target, folder, place)[0], place).out)

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

    def message(self, target: str, kind: str, draw: Draw) -> str:
        """Make an input of a kind, run the commands, and return the refusal; nothing if it was accepted.

        Raises:
            AssertionError: it ended otherwise.
        """
        with tempfile.TemporaryDirectory() as place:
            home, folder, here = Path(place), Path(place) / "base", Path(place) / "here"
            home.chmod(0o755)
            here.mkdir()
            shutil.copytree(self.intact[target], folder)
            expected = KINDS[target][kind](folder, draw)
            there, nobody, runs = set(home.rglob("*")), kind.startswith("closed"), []
            for arguments in commands(target, folder, home / "made")[: 1 if self.brief else None]:
                runs.append(self.tulip(arguments, here, nobody))
                if runs[-1].code:
                    break
            if target == "measurements" and not self.brief:
                check_preflight(self.tulip(["check", str(folder), "--json"], here, nobody), runs[-1])
            left = [path for path in set(home.rglob("*")) - there if "made" not in path.parts]
            assert not left, f"left behind: {left}"
            for run in runs:
                fault = "tulip: warning: " in run.err and "says more\n" in run.err  # the preflight fails
                assert run.code or not run.err or (fault and run.err.count("\n") == 1), run
            if runs[-1].code:
                return check_refusal(runs[-1], expected, home)
            check_result(json.loads(runs[0].out), expected, target, folder, self.results[target])
            return ""


def check_preflight(checked: Run, identified: Run) -> None:
    """Check that a preflight reads what identify can; it may judge more strictly."""
    assert checked.code in (0, 1, 2), checked
    assert checked.err.count("\n") <= (checked.code == 2), checked
    assert not checked.out or isinstance(json.loads(checked.out), dict)
    assert identified.code or checked.code < 2, f"it cannot read what identify can: {checked}"


def check_refusal(run: Run, expected: Expected, home: Path) -> str:
    """Check that a refusal is one message that names a place or an option, and return it."""
    assert (run.code, run.out) == (2, ""), run
    assert run.err.startswith("tulip: "), run.err
    assert run.err.count("\n") == 1, run.err
    assert len(run.err) <= 3_000, run.err
    assert expected.outcome in ("refused", "either"), run.err
    assert [word for word in expected.words if word not in run.err] == [], run.err
    # That no posture could be held is a finding, not a fault of one file.
    assert any(sign in run.err for sign in (str(home), "--", "postures could be measured")), run.err
    return run.err


def check_result(document: Any, expected: Expected, target: str, folder: Path, before: Any) -> None:
    """Check that a result is complete and agrees with the intact input's or with an independent reading."""
    assert expected.outcome != "refused", "accepted"
    assert not unknown(document), "a result that is no number"
    wanted = result(target, before) if expected.outcome == "same" else reading(target, folder)
    for name, found in result(target, document).items():
        right = np.asarray(wanted[name], float)
        most = TOLERANCE * max(np.abs(right).max(), 1e-9)
        np.testing.assert_allclose(np.asarray(found, float), right, rtol=0, atol=most, err_msg=name)


def unknown(value: Any) -> bool:
    """Return whether a document holds a null where a number was computed."""
    if isinstance(value, dict):
        value = [inner for key, inner in value.items() if key not in MAY_BE_NULL]
    return any(map(unknown, value)) if isinstance(value, list) else value is None


def result(target: str, document: Any) -> dict[str, Any]:
    """Return what is compared of a result."""
    if target == "plan":
        return {name: document[name] for name in ("postures", "placements", "condition_number")}
    if target == "robot":
        masses = {row["link"]: row["mass"] for row in document["standard"]}
        return {"masses": [masses[link] for link in sorted(masses)], "total": document["total_mass"]}
    estimates = [row["estimate"] for row in document["full"]["parameters"]]
    return {
        "postures": document["postures"],
        "estimates": estimates,
        "mass": document["total_mass"]["estimate"],
    }


def reading(target: str, folder: Path) -> dict[str, Any]:
    """Return the same, read and computed another way: the XML's masses, or ordinary least squares."""
    if target == "robot":
        bodies = {str(body.get("name")): body for body in ET.parse(folder / "tulip.xml").iter("body")}
        masses = [float(bodies[link].findall("inertial")[-1].get("mass", "nan")) for link in sorted(bodies)]
        return {"masses": masses, "total": sum(masses)}
    path, parameters = folder / "postures.parquet", base_parameters(load_robot())
    if path.exists():
        table = pd.read_parquet(path)
    else:
        table = pd.read_csv(path.with_suffix(".csv"), encoding="utf-8-sig")
    numbers = table.filter(regex=r"^(q|cell|plate)\.").astype(float)
    column = {name: numbers[name].to_numpy() for name in numbers}
    matrix = stacked_regressor(
        parameters, np.column_stack([column[f"q.{j}"] for j in parameters.tree.joints])
    )
    if target == "plan":
        placements = len(set(table["placement"]))
        return {"postures": len(table), "placements": placements, "condition_number": np.linalg.cond(matrix)}
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8-sig"))
    force, moment = np.zeros(len(table)), np.zeros((len(table), 2))
    for plate, corner in itertools.product(PLATES, CORNERS):
        x, y, yaw = (column[f"plate.{plate}.{axis}"] for axis in ("x", "y", "yaw"))
        (a, b), cell = manifest["plates"][plate]["cells"][corner], column[f"cell.{plate}.{corner}"]
        force += cell
        moment[:, 0] += cell * (x + np.cos(yaw) * a - np.sin(yaw) * b)
        moment[:, 1] += cell * (y + np.sin(yaw) * a + np.cos(yaw) * b)
    estimates = np.linalg.lstsq(matrix, (moment / force[:, None]).ravel(), rcond=None)[0]
    return {"postures": len(table), "estimates": estimates, "mass": np.mean(force / manifest["gravity"])}
