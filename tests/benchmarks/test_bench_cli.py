"""`make bench`: how quickly the command line starts, in CPU time of `python -c "import numpy"`."""

import resource
import statistics
import subprocess
import sys

from tulip_testbed.cli.main import COMMANDS

ROUNDS = 9
NUMPY = [sys.executable, "-c", "import numpy"]
TULIP = [sys.executable, "-c", "from tulip_testbed.cli.entry import run; run()"]


def cpu_s(command: list[str]) -> float:
    """Return user and system time of a process [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_start(benchmark):
    """Medians of alternating runs; the table is printed, nothing is asserted."""
    cases = [["--version"], ["--help"], *([name, "--help"] for name in COMMANDS)]

    def measured() -> list[str]:
        lines = []
        for case in cases:
            pairs = [(cpu_s([*TULIP, *case]), cpu_s(NUMPY)) for _ in range(ROUNDS)]
            own, numpy = (statistics.median(times) for times in zip(*pairs, strict=True))
            lines.append(f"{'tulip ' + ' '.join(case):24}{own:8.3f} s{own / numpy:8.2f} times numpy")
        return lines

    print("", *benchmark.pedantic(measured, rounds=1), sep="\n")
