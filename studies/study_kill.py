"""What does kill -9 leave behind? Fifty kills of real `tulip` processes. A Markdown table.

Half of the kills aim at the moment of writing: the study watches the target's parent until the hidden
folder in which the result is solved_plan holds its first file, and kills a random part of the time later
that an undisturbed run needs from there to the final name. A hidden folder left behind proves the hit.
docs/reliability.md holds the result.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from studies.runner import header, part_of, row
from tulip_testbed.sim.measurements import read_measurements, read_plan, write_plan
from tulip_testbed.sim.robot import load_robot

TULIP = [sys.executable, "-c", "from tulip_testbed.cli.entry import run; run()"]
AIMED = 0.6  # share of the kills that aim at the writing
OUTCOMES = ("before", "hit", "after", "BROKEN")


@dataclass
class Job:
    """A command that writes a folder, how to tell that it is whole, and how long it takes.

    Attributes:
        arguments: of the command; it runs in `place` and writes `out`.
        check: raises, or asserts, if the folder `out` is not whole.
        total: time of an undisturbed run [s].
        window: time of that from the hidden folder's appearance to the final name [s].
    """

    name: str
    arguments: list[str]
    place: Path
    check: Callable[[Path], None]
    total: float = 0.0
    window: float = 0.0
    tally: Counter[tuple[bool, str]] = field(default_factory=Counter)

    @property
    def out(self) -> Path:
        return self.place / "out"

    def start(self) -> subprocess.Popen[bytes]:
        quiet = subprocess.DEVNULL
        return subprocess.Popen(
            [*TULIP, *self.arguments], cwd=self.place, stdout=quiet, stderr=quiet, start_new_session=True
        )

    def partial(self) -> set[str]:
        """Hidden folders and files beside the results."""
        return {name for name in os.listdir(self.place) if name.startswith(".")}

    def writing(self, before: set[str]) -> bool:
        """Whether a new hidden folder holds something; an empty one only tries whether one can be made."""
        with contextlib.suppress(FileNotFoundError):
            return any(os.listdir(self.place / name) for name in self.partial() - before)
        return False

    def clear(self) -> None:
        """Remove results, but not what killed runs left behind."""
        shutil.rmtree(self.out, ignore_errors=True)
        (self.place / "truth.json").unlink(missing_ok=True)


def is_measurement(out: Path) -> None:
    """With its truth: that is written first."""
    assert len(read_measurements(out)) > 0
    assert json.loads((out.parent / "truth.json").read_text())["format"] == "tulip-truth"


def is_plan(out: Path) -> None:
    robot = load_robot()
    assert len(read_plan(out, robot)) > 0


def is_run(out: Path) -> None:
    """Every file that run.json lists is there, whole, and none that it does not list."""
    listed = json.loads((out / "run.json").read_text())["outputs"]
    files = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    assert files == {*listed, "run.json"}
    for name, expected in listed.items():
        assert hashlib.sha256((out / name).read_bytes()).hexdigest() == expected
    is_plan(out / "plan")
    assert len(read_measurements(out / "measurements")) > 0


def time_one(job: Job) -> None:
    """An undisturbed run: it has to succeed and to leave nothing but its result."""
    job.clear()
    began, observed = time.perf_counter(), None
    before = job.partial()
    process = job.start()
    while process.poll() is None:
        if observed is None and job.writing(before):
            observed = time.perf_counter()
        if observed is not None and job.out.exists():
            break
    written = time.perf_counter()
    assert process.wait() in (0, 1), f"{job.name} ended with {process.returncode}"
    job.check(job.out)
    assert not job.partial(), f"{job.name} left {job.partial()}"
    job.total, job.window = written - began, written - (observed or written)


def kill_one(job: Job, aimed: bool, chance: random.Random) -> str:
    """Start, kill, look."""
    job.clear()
    before = job.partial()
    process = job.start()
    if aimed:
        while process.poll() is None and not job.writing(before) and not job.out.exists():
            pass
        moment = time.perf_counter() + chance.uniform(0.0, 1.1 * job.window)
        while time.perf_counter() < moment:
            pass
    else:
        time.sleep(chance.uniform(0.0, job.total))
    process.send_signal(signal.SIGKILL)
    process.wait()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)  # its workers
    if job.out.exists():
        try:
            job.check(job.out)
        except Exception as error:
            print(f"{job.name}: {error!r}", file=sys.stderr)
            return "BROKEN"
        return "after"
    with contextlib.suppress(FileNotFoundError):
        json.loads((job.place / "truth.json").read_text())
    return "hit" if job.partial() - before else "before"


def jobs(place: Path) -> list[Job]:
    folders = [place / name for name in ("postures", "simulate", "validate")]
    for folder in folders:
        folder.mkdir()
    draw = ["postures", "--random", "--placements", "4", "--per-placement", "5", "--seed", "107"]
    plan = place / "plan"
    subprocess.run([*TULIP, *draw, "--out", str(plan), "--json"], check=True, stdout=subprocess.DEVNULL)
    robot = load_robot()
    whole = read_plan(plan, robot)
    write_plan(place / "first", part_of(whole, np.arange(5)))
    simulate = ["simulate", str(place / "first"), "--out", "out", "--truth", "truth.json"]
    return [
        Job("postures --random", [*draw, "--out", "out"], folders[0], is_plan),
        Job("simulate --truth", simulate, folders[1], is_measurement),
        Job("validate", ["validate", str(plan), "--out", "out"], folders[2], is_run),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1_000)
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as place:
        made = jobs(Path(place))
        for job in made:
            time_one(job)
        for k in range(arguments.kills):
            job, aimed = made[k % len(made)], k % 10 < 10 * AIMED
            job.tally[aimed, kill_one(job, aimed, chance)] += 1
        outcomes = ("nothing yet", "hit while writing", "whole", "BROKEN")
        print(header("command", "run, writing (s)", "kills aimed", *outcomes))
        for job in made:
            for aimed, what in ((False, "at any moment"), (True, "at the writing")):
                counts = [job.tally[aimed, outcome] for outcome in OUTCOMES]
                print(row(job.name, f"{job.total:.1f}, {job.window:.3f}", f"{sum(counts)} {what}", *counts))
        for job in made:
            time_one(job)
        print("\nAfter one more run of each command, undisturbed, no hidden folder was left.")
    return int(any(job.tally[aimed, "BROKEN"] for job in made for aimed in (True, False)))


if __name__ == "__main__":
    sys.exit(main())
