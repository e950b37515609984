"""Kill -9 fifty `tulip` processes, most while they write: what is left? (docs/reliability.md; ten minutes)

Most kills aim at the moment of writing: the study watches for the first file in the hidden folder in which
the result is prepared, and kills a random part of the time later that an undisturbed run needs from there
to the final name. A hidden folder left behind proves the hit.
"""

from __future__ import annotations

import glob
import hashlib
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from studies.runner import Settings, header, row
from tulip_testbed.sim.measurements import read_measurements, read_plan, write_plan
from tulip_testbed.sim.robot import load_robot

TULIP = [sys.executable, "-c", "from tulip_testbed.cli.entry import run; run()"]
SHAPE = ["--placements", "4", "--per-placement", "5", "--seed", "107"]
SETTINGS = Settings(seed=1_000)
OUTCOMES = ("nothing yet", "hit while writing", "whole", "BROKEN")


def check_plan(out: Path) -> None:
    assert len(read_plan(out, load_robot())) > 0


def check_measurements(out: Path) -> None:
    """With their truth, which is written first."""
    assert len(read_measurements(out)) > 0
    assert json.loads(out.with_name("truth.json").read_text())["format"] == "tulip-truth"


def check_run(out: Path) -> None:
    """Every file that run.json lists is there, whole, and none that it does not list."""
    listed = json.loads((out / "run.json").read_text())["outputs"]
    found = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    del found["run.json"]
    assert {name: hashlib.sha256(content).hexdigest() for name, content in found.items()} == listed
    check_plan(out / "plan")
    assert len(read_measurements(out / "measurements")) > 0


COMMANDS: dict[str, tuple[list[str], Callable[[Path], None]]] = {
    "postures --random": (["postures", "--random", *SHAPE, "--out", "out"], check_plan),
    "simulate --truth": (
        ["simulate", "../first", "--out", "out", "--truth", "truth.json"],
        check_measurements,
    ),
    "validate": (["validate", "../plan", "--out", "out"], check_run),
}


def hidden(place: Path, pattern: str = ".*") -> set[str]:
    """Names of the hidden folders; with the pattern `.*/*`, of those that hold something."""
    return {path.split("/")[0] for path in glob.glob(pattern, root_dir=place)}


def attempt(name: str, place: Path, after: float = math.inf, aimed: bool = False) -> tuple[str, float, float]:
    """Run a command, and kill it some seconds after its start or, aimed, after the first file that it writes.

    Returns:
        Which of `OUTCOMES` it left, the seconds from its start to the final name, those since the first file.
    """
    arguments, check = COMMANDS[name]
    out, before = place / "out", hidden(place)
    shutil.rmtree(out, ignore_errors=True)
    (place / "truth.json").unlink(missing_ok=True)
    with open(os.devnull, "w") as quiet:
        process = subprocess.Popen(
            [*TULIP, *arguments], cwd=place, stdout=quiet, stderr=quiet, start_new_session=True
        )
    now = began = time.perf_counter()
    wrote = named = math.inf
    while process.poll() is None:
        now = time.perf_counter()
        if wrote == math.inf and hidden(place, ".*/*") - before:
            wrote = now
        if named == math.inf and out.exists():
            named = now
        if now > (wrote if aimed else began) + after:
            os.killpg(process.pid, signal.SIGKILL)  # with its workers
    left = "whole" if out.exists() else "hit while writing" if hidden(place) - before else "nothing yet"
    try:
        for truth in place.glob("truth.json"):
            json.loads(truth.read_text())
        if out.exists():
            check(out)
    except Exception as error:
        print(f"{name}: {error!r}", file=sys.stderr)
        left = "BROKEN"
    named = min(named, now)
    return left, named - began, named - wrote


def undisturbed(name: str, place: Path) -> tuple[float, float]:
    """Times of a run that has to succeed and to leave nothing but its result."""
    left, total, writing = attempt(name, place)
    assert left == "whole", name
    assert not hidden(place), name
    return total, writing


def study(settings: Settings) -> Iterator[str]:
    """Yield the table of what was left."""
    chance, names, tally = random.Random(settings.seed), list(COMMANDS), Counter()
    with tempfile.TemporaryDirectory() as temporary:
        home = Path(temporary)
        places = {name: home / str(k) for k, name in enumerate(names)}
        for place in places.values():
            place.mkdir()
        draw = [*TULIP, "postures", "--random", *SHAPE, "--out", "plan", "--json"]
        subprocess.run(draw, cwd=home, check=True, stdout=subprocess.DEVNULL)
        write_plan(home / "first", read_plan(home / "plan", load_robot()).take(np.arange(5)))
        times = {name: undisturbed(name, places[name]) for name in names}
        for k in range(settings.count(50)):
            name, aimed = names[k % len(names)], k % 10 < 6
            total, writing = times[name]
            after = chance.uniform(0.0, 1.1 * writing if aimed else total)
            tally[name, aimed, attempt(name, places[name], after, aimed)[0]] += 1
        for name in names:
            undisturbed(name, places[name])
    yield header("command", "run, writing (s)", "kills aimed", *OUTCOMES)
    for name, (total, writing) in times.items():
        for aimed, what in ((False, "at any moment"), (True, "at the writing")):
            counts = [tally[name, aimed, outcome] for outcome in OUTCOMES]
            yield row(name, f"{total:.1f}, {writing:.3f}", f"{sum(counts)} {what}", *counts)
    yield "\nAfter one more run of each command, undisturbed, no hidden folder was left."
