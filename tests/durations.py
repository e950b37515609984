"""Record the processor time of every test of the default suite (`make durations`), and read the record.

Loaded as a plugin of pytest (`-p tests.durations`) it writes `tests/durations.csv`: seconds of processor time
of a test and of the processes that it started, summed over its parameters. What test processes use outside of
tests (imports, collection) is a row of its own.
"""

import ast
import csv
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

TESTS = Path(__file__).resolve().parent
TABLE = TESTS / "durations.csv"
OUTSIDE = "(outside tests)"

_spent: defaultdict[str, float] = defaultdict(float)
_collected: dict[str, float] = {}  # by pytest-xdist's controller


def read_durations() -> dict[str, float]:
    """Return the recorded processor time of each test [s]."""
    with TABLE.open(newline="") as file:
        return {row["test"]: float(row["seconds"]) for row in csv.DictReader(file)}


def default_tests() -> set[str]:
    """Return the names of the tests that are not marked slow, as the source shows them."""
    names = set()
    for path in sorted(TESTS.rglob("test_*.py")):
        module = ast.parse(path.read_text(encoding="utf-8"))
        for node in module.body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                marks = [ast.unparse(mark) for mark in node.decorator_list]
                if "pytest.mark.slow" not in marks:
                    names.add(f"tests/{path.relative_to(TESTS).as_posix()}::{node.name}")
    return names


def cpu_seconds() -> float:
    """Return the processor time of this process and of its children that have ended [s]."""
    return sum(os.times()[:4])


def outside_tests() -> float:
    """Return the processor time that no test was charged with: also that of workers that still wait [s]."""
    waiting = psutil.Process().children(recursive=True)
    return cpu_seconds() + sum(sum(one.cpu_times()[:4]) for one in waiting) - sum(_spent.values())


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    began = cpu_seconds()
    done = yield
    _spent["::".join(item.nodeid.partition("[")[0].split("::")[:2])] += cpu_seconds() - began
    return done


def pytest_testnodedown(node: Any) -> None:
    for name, seconds in getattr(node, "workeroutput", {}).get("durations", {}).items():
        _collected[name] = _collected.get(name, 0.0) + seconds


def pytest_sessionfinish(session: pytest.Session) -> None:
    config: Any = session.config
    if hasattr(config, "workeroutput"):
        config.workeroutput["durations"] = {**_spent, OUTSIDE: outside_tests()}
        return
    if not _collected:  # no pytest-xdist
        _collected.update(_spent, **{OUTSIDE: outside_tests()})
    rows = sorted(_collected.items(), key=lambda row: (-round(row[1], 2), row[0]))
    lines = ["test,seconds", *(f"{name},{seconds:.2f}" for name, seconds in rows)]
    path = Path(os.environ.get("DURATIONS", TABLE))
    path.write_text("\n".join(lines) + "\n")
