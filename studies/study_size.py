"""Time and memory of commands against the rows of their measurements (docs/studies/reliability.md; half an hour)."""

import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import tulip_testbed as tt
from studies.runner import Settings, header, row
from tulip_testbed.measurements import Measurements, joined

RUNS = 13, 65  # of one laboratory; the contract allows 10,000 rows
SETTINGS = Settings(seed=0, only=("check", "identify", "discover"))
COMMAND = sys.executable, "-c", "from tulip_testbed.cli.entry import run; run()"


def as_one(runs: list[Measurements]) -> Measurements:
    """Return several runs of one laboratory as one experiment."""
    return dataclasses.replace(joined(runs), experiments=(), experiment=None)


def cost(command: str, folder: Path) -> tuple[float, float]:
    """Return elapsed time [s] and peak memory [GB] of a command."""
    begin = time.perf_counter()
    process = subprocess.Popen([*COMMAND, command, folder], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)  # `Popen` did not see it end
    assert process.returncode in (0, 1)  # 1: `check` fails a folder in which an encoder is off
    return time.perf_counter() - begin, 1.024e-6 * used.ru_maxrss


def study(settings: Settings) -> Iterator[str]:
    """Yield a row a command and size."""
    laboratory = tt.Laboratory(sensors="wii").with_effects("encoder-offset:right_knee=0.02")
    counts = [settings.count(count) for count in RUNS]
    seeds = range(settings.seed, settings.seed + max(counts))
    runs = [laboratory.run(tt.plans.random, seed, "statics").measurements for seed in seeds]
    yield header("command", "rows", "placements", "seconds", "times the first", "GB")
    first: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as place:
        for count in counts:
            measured, folder = as_one(runs[:count]), Path(place) / str(count)
            placements = len(np.unique(measured.placement))
            tt.write_measurements(folder, measured)
            for command in settings.only:
                seconds, memory = cost(command, folder)
                ratio = seconds / first.setdefault(command, seconds)
                cells = f"{seconds:.2g}", f"{ratio:.1f}", f"{memory:.2f}"
                yield row(command, len(measured), placements, *cells)
