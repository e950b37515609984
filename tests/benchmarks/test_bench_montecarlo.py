"""Memory of a Monte Carlo does not grow with its runs: peak of a process with 1,000 and with 10,000."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
# Peak resident size [KiB] of a process that collects and summarises; two chunks differ by their own noise.
PEAK = """
import resource, sys
from pathlib import Path
from tests.montecarlo_work import Regressions, result_of, run_regressions
chunks = run_regressions(Path(sys.argv[1]), int(sys.argv[2]), 25, Regressions(), int(sys.argv[3]))
result_of(chunks)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak(folder: Path, runs: int, workers: int) -> float:
    """MiB."""
    command = [sys.executable, "-c", PEAK, str(folder / str(runs)), str(runs), str(workers)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return int(done.stdout) / 1024


@pytest.mark.parametrize("workers", [1, 2])
def test_memory_does_not_grow_with_the_runs(benchmark, tmp_path, workers):
    few = peak(tmp_path, 1_000, workers)
    many = benchmark.pedantic(peak, (tmp_path, 10_000, workers), rounds=1)
    slope = 1024 * (many - few) / 9_000
    print(f"\n{workers} workers: {few:.0f} MiB at 1,000 runs, {many:.0f} at 10,000: {slope:.2f} KiB a run")
    assert slope < 1.0  # its row alone has some 0.4 KiB of numbers
    assert many < 2048
