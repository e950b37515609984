"""Run the benchmark of `tulip discover` at both presets (docs/studies/discovery-benchmark.md; hours, resumable).

The cases and their CSV files stay in a folder for each preset.
"""

from __future__ import annotations

from collections.abc import Iterator

from studies.runner import Settings
from tulip_testbed.base.files import write_text
from tulip_testbed.experiments.benchmark.benchmark_run import benchmark
from tulip_testbed.experiments.benchmark.benchmark_tables import files, report_text
from tulip_testbed.experiments.benchmark.cases import Settings as BenchmarkSettings

SETTINGS = Settings(seed=4000, only=("force-plate", "wii"))


def study(settings: Settings) -> Iterator[str]:
    """Yield the report of each preset."""
    for number, preset in enumerate(SETTINGS.only):  # each preset has a seed of its own
        if preset in settings.only:
            folder = settings.folder("discover") / preset
            chosen = BenchmarkSettings(preset, settings.seed + number, settings.size)
            outcomes = benchmark(chosen, folder, settings.workers)
            for name, text in files(outcomes, f"{len(outcomes)} cases, {chosen}").items():
                write_text(folder / name, text)
            spent = sum(o.wall_s for o in outcomes) / len(outcomes)
            yield f"## {preset}\n\n{len(outcomes)} cases; mean wall clock of a discovery {spent:.1f} s."
            yield f"\n{report_text(outcomes)}\n"
