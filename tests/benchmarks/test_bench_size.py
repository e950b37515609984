"""Time and memory of a command against the rows of its measurements, as ratios within one run.

The folders hold four and sixteen runs of one laboratory, 30 placements each: what grows with the square of
the rows takes sixteen times as long for four times as many. `RUNS=65 make bench` has the 10,000 rows that
the contract allows in place of sixteen runs (docs/studies/reliability.md).
"""

import dataclasses
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.measurements import Measurements, write_measurements

TULIP = Path(__file__).parents[2] / ".venv/bin/tulip"
FEW, MANY = 4, int(os.environ.get("RUNS", "16"))


def joined(runs: list[Measurements]) -> Measurements:
    """Return several runs of one laboratory as one experiment."""
    first, out = runs[0], {}
    offset = {
        "placement": first.placement.max(),
        "posture": first.posture.max(),
        "time": 1.1 * first.time.max(),
    }
    for field in dataclasses.fields(first):
        each = [getattr(run, field.name) for run in runs]
        if isinstance(each[0], np.ndarray) and field.name not in ("cells", "top_height"):
            step = offset.get(field.name)
            moved = each if step is None else [part + k * step for k, part in enumerate(each)]
            out[field.name] = np.concatenate(moved)
    return dataclasses.replace(first, **out)


def cost(command: str, folder: Path) -> tuple[float, float]:
    """Return elapsed time [s] and peak memory [GB] of a command."""
    begin = time.perf_counter()
    process = subprocess.Popen([TULIP, command, folder], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)  # `Popen` did not see it end
    assert process.returncode in (0, 1)  # 1: `check` fails a folder in which an encoder is off
    return time.perf_counter() - begin, 1.024e-6 * used.ru_maxrss


@pytest.mark.parametrize("command", ["check", "identify", "discover"])
def test_cost_against_rows(benchmark, robot, plan, tmp_path, command):
    laboratory = Laboratory(robot, "wii").with_effects("encoder-offset:right_knee=0.02")
    runs = [laboratory.run(plan, seed, "statics").measurements for seed in range(MANY)]
    found = []
    for count in (FEW, MANY):
        measured = joined(runs[:count])
        write_measurements(tmp_path / str(count), measured)
        found.append((len(measured), *cost(command, tmp_path / str(count))))
    benchmark.pedantic(lambda: None, rounds=1)
    (few, short, small), (many, long, large) = found
    print(
        f"\n{command}: {few} rows {short:.1f} s, {small:.2f} GB; {many} rows {long:.1f} s, {large:.2f} GB: "
        f"{long / short:.1f} times the time for {many / few:.1f} times the rows"
    )
