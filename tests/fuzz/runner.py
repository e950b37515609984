"""Run mutated inputs through the real command line, in processes that may crash, hang or warn."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.cases import MUTATIONS, Expected, Mutation, manifest_of
from tests.fuzz.robot_cases import ROBOT_MUTATIONS

SECONDS = {"measurements": 60, "plan": 60, "robot": 240}
NOBODY = 65534


@dataclass(frozen=True)
class Case:
    """One mutated input: which base, which mutation, which seed."""

    target: str
    mutation: str
    seed: int


@dataclass(frozen=True)
class Bases:
    """The intact inputs that cases start from."""

    measurements: Path
    plan: Path
    robot: Path
    small_plan: Path


@dataclass(frozen=True)
class Outcome:
    """How a case ended: "accepted", "refused", or what was wrong."""

    case: Case
    result: str
    detail: str
    seconds: float

    @property
    def failed(self) -> bool:
        return self.result not in ("accepted", "refused")


@dataclass(frozen=True)
class Run:
    """What one call of the command line did."""

    code: int | str
    out: str
    err: str


def run_cases(cases: list[Case], bases: Bases, workers: int, brief: bool = False) -> Iterator[Outcome]:
    """Outcomes as they come in; a process that dies or hangs is replaced.

    Args:
        brief: only the first call of the command line that reads the input.
    """
    context = multiprocessing.get_context("spawn")
    todo = list(reversed(cases))
    pool: dict[Connection, tuple[Any, Case, float]] = {}

    def start() -> Connection:
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, bases, brief), daemon=True)
        process.start()
        theirs.close()
        return give(ours, process)

    def give(connection: Connection, process: Any) -> Connection:
        case = todo.pop()
        with contextlib.suppress(BrokenPipeError):
            connection.send(case)
        pool[connection] = (process, case, time.monotonic())
        return connection

    for _ in range(min(workers, len(todo))):
        start()
    while pool:
        ready = wait(list(pool), timeout=1.0)
        for connection in list(pool):
            process, case, began = pool[connection]
            taken = time.monotonic() - began
            if connection in ready:
                try:
                    outcome = connection.recv()
                except EOFError:
                    process.join()
                    outcome = Outcome(case, "crashed", f"exit code {process.exitcode}", taken)
                    process = None
            elif taken > SECONDS[case.target] + 30:  # a process of its own needs a while to load
                process.kill()
                outcome, process = Outcome(case, "hung", f"after {taken:.0f} s", taken), None
            else:
                continue
            del pool[connection]
            yield outcome
            if process is not None and todo:
                give(connection, process)
            elif process is not None:
                connection.close()
            elif todo:
                start()


def _work(connection: Connection, bases: Bases, brief: bool) -> None:
    """A worker's life: cases in, outcomes out."""
    warnings.simplefilter("error")
    stray = tempfile.mkdtemp()
    os.chdir(stray)
    for number in (1, 2):
        with tempfile.TemporaryFile() as file:
            os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = (os.fdopen(os.dup(n), "w", encoding="utf-8", buffering=1) for n in (1, 2))
    from tulip_testbed.cli.main import main

    before = {target: _results(bases, target, main) for target in SECONDS}
    with contextlib.suppress(EOFError, KeyboardInterrupt):
        while True:
            case = connection.recv()
            began = time.monotonic()
            try:
                result, detail = _judge(case, bases, before[case.target], main, brief)
            except Exception:
                result, detail = "the study is broken", traceback.format_exc()
            if left := os.listdir(stray):
                result, detail = "left something behind", f"in the working folder: {left}"
                shutil.rmtree(stray)
                os.mkdir(stray)
                os.chdir(stray)
            connection.send(Outcome(case, result, detail, time.monotonic() - began))


def _judge(case: Case, bases: Bases, before: dict[str, Any], main: Any, brief: bool) -> tuple[str, str]:
    with tempfile.TemporaryDirectory() as place:
        home = Path(place)
        home.chmod(0o755)
        folder = home / "base"
        shutil.copytree(getattr(bases, case.target), folder)
        expected = _mutations(case.target)[case.mutation](folder, np.random.default_rng(case.seed))
        there = set(home.rglob("*"))
        runs = []
        with _as_nobody(case.mutation == "no_permission"):
            for arguments in _commands(case.target, folder, home, bases):
                runs.append(_call(main, arguments))
                if brief or runs[-1].code != 0:
                    break
            checked = None
            if case.target == "measurements" and not brief:
                checked = _call(main, ["check", str(folder), "--json"])
        last = runs[-1]
        if isinstance(last.code, str):
            return last.code, last.err
        if checked and (text := _wrong_check(checked, last)):
            return "tulip check", text
        new = {path for path in set(home.rglob("*")) - there if "made" not in path.parts}
        if new:
            return "left something behind", str(new)
        if any(run.err for run in runs[:-1]) or (last.code == 0 and last.err):
            return "said something on stderr", "".join(run.err for run in runs)
        if last.code not in (0, 2):
            return "wrong exit code", f"{last.code}: {last.err}"
        if last.code == 2:
            return _judge_refusal(expected, last, home)
        return _judge_result(case, expected, json.loads(runs[0].out), before, folder)


def _wrong_check(checked: Run, identified: Run) -> str:
    """What is wrong with a preflight; it may list what identify refuses at once, and judge more strictly."""
    if checked.code not in (0, 1, 2) or checked.err.count("\n") or (checked.code != 2 and checked.err):
        return f"{checked.code}: {checked.err}"
    if checked.out and not isinstance(json.loads(checked.out), dict):
        return checked.out[:300]
    if identified.code == 0 and checked.code == 2:
        return f"cannot read what identify can: {checked.out[:300]} {checked.err}"
    return ""


def _judge_refusal(expected: Expected, run: Run, home: Path) -> tuple[str, str]:
    if run.out:
        return "refused after output", run.out[:200]
    if len(run.err.splitlines()) != 1 or not run.err.startswith("tulip: "):
        return "not one message", run.err
    if len(run.err) > 3_000:
        return "too long a message", run.err[:500]
    if expected.outcome == "accepted":
        return "refused in error", run.err
    if missing := [word for word in expected.words if word not in run.err]:
        return "message lacks " + ", ".join(missing), run.err
    # That no posture could be held is a finding, not a fault of one file.
    if not any(sign in run.err for sign in (str(home), "base", "--", "postures could be measured")):
        return "message names no file", run.err
    return "refused", run.err


def _judge_result(
    case: Case, expected: Expected, document: dict[str, Any], before: dict[str, Any], folder: Path
) -> tuple[str, str]:
    from tests.fuzz import oracle

    if expected.outcome == "refused":
        return "accepted in error", json.dumps(document)[:300]
    if oracle.not_finite(document):
        return "accepted with a result that is no number", json.dumps(document)[:300]
    found, right = {
        "measurements": (oracle.found_identification, oracle.expected_identification),
        "plan": (oracle.found_plan, oracle.expected_plan),
        "robot": (oracle.found_robot, oracle.expected_robot),
    }[case.target]
    wanted = found(before) if expected.as_before else right(folder)
    if text := oracle.difference(wanted, found(document)):
        return "accepted with a wrong result", text
    return "accepted", ""


def _mutations(target: str) -> dict[str, Mutation]:
    return ROBOT_MUTATIONS if target == "robot" else MUTATIONS


def _commands(target: str, folder: Path, home: Path, bases: Bases) -> Iterator[list[str]]:
    """The calls that one input goes through, each only if those before it went well."""
    made = home / "made"
    if target == "measurements":
        # The oracle solves eq. 8.
        yield ["identify", str(folder), "--estimator", "least-squares", "--json"]
        yield ["identify", str(folder)]
    elif target == "plan":
        yield ["postures", str(folder), "--json"]
        yield ["postures", str(folder)]
    else:
        robot = ["--robot", str(folder / "tulip.toml")]
        yield ["model", *robot, "--json"]
        yield ["model", *robot]
        made.mkdir()
        few = ["--placements", "3", "--per-placement", "5", "--seed", "107"]
        yield ["postures", "--random", "--out", str(made / "plan"), *few, *robot]
        plan = _plan_for(folder, made, bases)
        yield [
            "simulate",
            str(plan),
            "--out",
            str(made / "data"),
            "--workers",
            "1",
            "--preset",
            "ideal",
            *robot,
        ]


def _plan_for(folder: Path, made: Path, bases: Bases) -> Path:
    """The small plan with the mutated model's hash."""
    from tulip_testbed.sim.robot import load_robot, sha256

    plan = made / "small"
    shutil.copytree(bases.small_plan, plan)
    path = manifest_of(plan)
    content = json.loads(path.read_text())
    content["robot"]["sha256"] = sha256(load_robot(folder / "tulip.toml").model)
    path.write_text(json.dumps(content))
    return plan


def _call(main: Any, arguments: list[str]) -> Run:
    """One call of the command line with what it and its libraries in C wrote."""
    for number in (1, 2):
        os.ftruncate(number, 0)
        os.lseek(number, 0, os.SEEK_SET)
    try:
        code: int | str = main(arguments)
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else "stopped"
    except Exception as error:
        code = "warning" if isinstance(error, Warning) else "traceback"
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    texts = [os.pread(number, 10_000_000, 0).decode("utf-8", "replace") for number in (1, 2)]
    lines = [line for line in texts[1].splitlines() if line.strip() and "folder: /" not in line]
    return Run(code, texts[0], "\n".join(lines))


def _results(bases: Bases, target: str, main: Any) -> dict[str, Any]:
    """What the intact input gives."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "base"
        shutil.copytree(getattr(bases, target), folder)
        run = _call(main, next(_commands(target, folder, Path(place), bases)))
    if run.code != 0:
        raise RuntimeError(f"the intact {target} ended with {run.code}: {run.err}")
    return json.loads(run.out)


@contextlib.contextmanager
def _as_nobody(wanted: bool) -> Iterator[None]:
    """For root every file is readable."""
    if not (wanted and os.geteuid() == 0):
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)
