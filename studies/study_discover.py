"""The honest test of the discovery: docs/discovery-benchmark.md's tables, printed as Markdown.

Each preset's cases stay in the folder given by --out; the same command resumes.
"""

from __future__ import annotations

import argparse
import os
from datetime import UTC, datetime
from pathlib import Path

from tulip_testbed.experiments.benchmark.benchmark_run import benchmark
from tulip_testbed.experiments.benchmark.benchmark_tables import files, report_text
from tulip_testbed.experiments.benchmark.cases import Settings
from tulip_testbed.sim.files import write_bytes

PRESETS = ("force-plate", "wii")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/study-discover"))
    parser.add_argument("--seed", type=int, default=4000)
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=PRESETS)
    arguments = parser.parse_args()
    began = datetime.now(UTC)
    arguments.out.mkdir(parents=True, exist_ok=True)
    parts = []
    for number, preset in enumerate(arguments.presets):
        folder = arguments.out / preset
        settings = Settings(preset, arguments.seed + number, arguments.size)
        outcomes = benchmark(settings, folder, arguments.workers)
        for name, text in files(outcomes, f"{len(outcomes)} cases, {settings}").items():
            write_bytes(folder / name, text.encode())
        spent = sum(o.wall_s for o in outcomes)
        parts.append(
            f"## {preset}\n\n{len(outcomes)} cases; a discovery took {spent / len(outcomes):.1f} s "
            f"in the mean (wall clock).\n\n{report_text(outcomes)}"
        )
    load = os.getloadavg()[2]
    print(
        f"Seeds from {arguments.seed}, one a preset, size {arguments.size:g}, {began:%Y-%m-%d %H:%M} to "
        f"{datetime.now(UTC):%H:%M} UTC, {arguments.workers} workers, load {load:.1f}.\n"
    )
    print("\n\n".join(parts))


if __name__ == "__main__":
    main()
