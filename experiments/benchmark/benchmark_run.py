"""The whole benchmark: begin or resume, compute what is missing, score."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError, at_least, look_up
from tulip_testbed.base.table_files import Columns
from tulip_testbed.base.threads import one_blas_thread, processes
from tulip_testbed.experiments.benchmark.case_outcome import Outcome, outcome
from tulip_testbed.experiments.benchmark.case_run import carry_out
from tulip_testbed.experiments.benchmark.cases import ORDINARY, WORLDS, Case, Settings, cases
from tulip_testbed.experiments.benchmark.ordinary_cases import ordinary_cases
from tulip_testbed.experiments.benchmark.ordinary_run import carry_out as carry_out_ordinary
from tulip_testbed.experiments.benchmark.scoreboard import board
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.engine import engine
from tulip_testbed.experiments.montecarlo.montecarlo_folder import (
    CHUNK_FOLDER,
    RunsFile,
    check_folder,
    made_in,
    open_folder,
)
from tulip_testbed.experiments.montecarlo.montecarlo_run import Progress, collect_missing, no_progress
from tulip_testbed.experiments.run_file import VERSION
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import load_robot

CHUNK = 1  # a case takes seconds


@dataclass(frozen=True)
class Job:
    """From numbers of cases to their outcomes; what they have in common is made in the worker."""

    settings: Settings
    plan: Path
    cases: tuple[Case, ...]

    @one_blas_thread
    def __call__(self, runs: Sequence[int]) -> Columns:
        documents = [json.dumps(self._outcome(run).document()) for run in runs]
        return {"run": np.array(runs), "outcome": np.array(documents, object)}

    def _outcome(self, run: int) -> Outcome:
        case, seed, preset = self.cases[run], self.settings.seed, self.settings.preset
        if self.settings.world == ORDINARY:
            robot = load_robot()
            return carry_out_ordinary(case, run, seed, preset, robot, read_plan(self.plan, robot))
        return carry_out(case, run, seed, board(preset, self.plan))


def benchmark(
    settings: Settings,
    folder: Path,
    workers: int,
    plan: Path = DEFAULT_PLAN,
    progress: Progress = no_progress,
    address: str | None = None,
) -> list[Outcome]:
    """Carry out what is missing in the folder; all outcomes.

    Args:
        workers: processes of this machine, if there is no address. address: of a Dask scheduler.

    Raises:
        InputError: what cannot be run, written or read; cases that were written stay.
        montecarlo.run.Interrupted: by Ctrl-C, after the folder was begun.
    """
    at_least("seed", settings.seed, 0)
    processes(workers)
    if not 0 < settings.size <= 10:
        raise InputError(f"size: found {settings.size:g}, expected more than 0 and at most 10")
    look_up("world", settings.world, WORLDS, "world")
    robot = load_robot()
    postures = read_plan(plan, robot)
    if settings.world == ORDINARY:
        every = tuple(ordinary_cases(settings, robot, postures))
    else:
        every = tuple(cases(settings, board(settings.preset, plan)))
    laboratory = Laboratory(robot, settings.preset)
    document = RunsFile[dict[str, Any]](
        format="tulip-benchmark",
        version=VERSION,
        command="benchmark discover",
        settings=settings.document(),
        **made_in(laboratory, postures, settings.seed, "statics"),
    )
    chunks = Chunks(folder / CHUNK_FOLDER, len(every), CHUNK)
    if not check_folder(folder, document) or chunks.missing():
        with engine(workers, address), open_folder(folder, document, postures):
            collect_missing(chunks, Job(settings, plan, every), folder, progress, "cases")
    return so_far(folder)


def so_far(folder: Path) -> list[Outcome]:
    """Outcomes of the cases that were carried out; any number of them is a fair sample of all.

    Raises:
        InputError: a file is damaged.
    """
    paths = sorted((folder / CHUNK_FOLDER).glob("chunk-*.parquet"))
    numbers = [int(path.stem.removeprefix("chunk-")) for path in paths]
    chunks = Chunks(folder / CHUNK_FOLDER, max(numbers, default=0) + 1, CHUNK)
    return [
        outcome(json.loads(text))
        for number in numbers
        for text in chunks.read_one(number, ["outcome"])["outcome"]
    ]
