"""The honest test of the discovery: docs/discovery-benchmark.md's tables, printed as Markdown.

Each preset's cases stay in the folder given by --out; the same command resumes.
"""

from __future__ import annotations

import argparse
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from experiments.discovery.benchmark.board import ISOLABLE, Board, board
from experiments.discovery.benchmark.cases import Settings
from experiments.discovery.benchmark.run import benchmark
from experiments.discovery.benchmark.tables import files, report_text
from experiments.effects import catalogue
from sim.files import write_bytes
from tools.study import header, row

PRESETS = ("force-plate", "wii")
DIRECTIONS = 20


def isolable_table(boards: dict[str, Board]) -> str:
    """How many targets of every kind nothing else can look like, in any of some random directions."""
    lines = [header("effect", *(f"{preset}: isolable targets" for preset in boards))]
    for name in catalogue():
        cells = []
        for made in boards.values():
            mine = [
                (c, points)
                for c, points in zip(made.candidates, made.projected, strict=True)
                if c.effect.name == name
            ]
            clear = [_alone(made, candidate.label, points) for candidate, points in mine]
            cells.append(f"{sum(clear)} of {len(clear)}")
        lines.append(row(name, *cells))
    return "\n".join(lines)


def _alone(made: Board, label: str, points: list[np.ndarray]) -> bool:
    rng = np.random.default_rng(0)
    for columns in points:
        for _ in range(DIRECTIONS if columns.shape[1] > 1 else 1):
            signal = columns @ rng.standard_normal(columns.shape[1])
            if np.linalg.norm(signal) < 1e-9 or made.twins(signal, [label]):
                return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/study-discover"))
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=PRESETS)
    arguments = parser.parse_args()
    began = datetime.now(UTC)
    arguments.out.mkdir(parents=True, exist_ok=True)
    parts = []
    for preset in arguments.presets:
        folder = arguments.out / preset
        outcomes = benchmark(Settings(preset, arguments.seed, arguments.size), folder, arguments.workers)
        for name, text in files(outcomes).items():
            write_bytes(folder / name, text.encode())
        spent = sum(o.wall_s for o in outcomes)
        parts.append(
            f"## {preset}\n\n{len(outcomes)} cases; a discovery took {spent / len(outcomes):.1f} s "
            f"in the mean (wall clock).\n\n{report_text(outcomes)}"
        )
    load = os.getloadavg()[2]
    print(
        f"Seed {arguments.seed}, size {arguments.size:g}, {began:%Y-%m-%d %H:%M} to "
        f"{datetime.now(UTC):%H:%M} UTC, {arguments.workers} workers, load {load:.1f}.\n"
    )
    print("\n\n".join(parts))
    print(f"\n## What is isolable (at least {ISOLABLE:g} deg from anything else)\n")
    print(isolable_table({preset: board(preset) for preset in arguments.presets}))


if __name__ == "__main__":
    main()
