"""The folder of a Monte Carlo: begun once, resumed by the same command, never mixed with another."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from pydantic import Field

from tulip_testbed.base.alone import alone_on
from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_new, new_folder, present
from tulip_testbed.base.machine import machine
from tulip_testbed.base.table_files import software
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.settings import MonteCarloSettings, Settings
from tulip_testbed.experiments.run_file import (
    PLAN_FOLDER,
    RUN_FILE,
    VERSION,
    Configuration,
    Head,
    Machine,
    check_configuration,
    configuration_of,
)
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import write_plan

CHUNK_FOLDER, REPORT_FILE = "runs", "report.json"
Asked = TypeVar("Asked")


class RunsFile(Head, Generic[Asked]):
    """run.json of a folder of many runs: everything that their results depend on."""

    settings: Asked
    configuration: Configuration
    inputs: dict[str, str]
    software: dict[str, str]
    machine: Machine = Field(default_factory=dict)


def made_in(laboratory: Laboratory, plan: PosturePlan, seed: int, engine: str) -> dict[str, Any]:
    """Return the part of run.json that speaks of laboratory, plan and versions.

    Args:
        seed, engine: see `Laboratory.run`.
    """
    return {
        "configuration": configuration_of(laboratory, plan, seed, engine),
        "inputs": laboratory.robot.hashes | {"plan": plan_hash(plan)},
        "software": software(),
        "machine": machine(),
    }


def montecarlo_file(
    laboratory: Laboratory, plan: PosturePlan, settings: Settings
) -> RunsFile[MonteCarloSettings]:
    """Make the run.json of a Monte Carlo."""
    return RunsFile[MonteCarloSettings](
        format="tulip-montecarlo",
        version=VERSION,
        command="montecarlo",
        settings=settings.document(),
        **made_in(laboratory, plan, settings.seed, settings.engine),
    )


def plan_hash(plan: PosturePlan) -> str:
    """Hash everything that a plan asks for, in hexadecimal."""
    digest = hashlib.sha256()
    arrays = {one.name: getattr(plan, one.name) for one in fields(plan)}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):  # what a plan asks for is in its arrays, wherever it comes from
            continue
        digest.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()


def check_plan(folder: Path, inputs: dict[str, str], plan: PosturePlan) -> None:
    """Refuse a plan that is not the one of the runs.

    Raises:
        InputError: its hash is another one.
    """
    expected = inputs.get("plan", "none")
    if (found := plan_hash(plan)) != expected:
        raise InputError(
            f"{folder / PLAN_FOLDER}: hash mismatch: found a plan with sha256 {found[:12]}..., expected "
            f"{shortened(expected[:12])}... by {RUN_FILE}"
        )


def check_folder(folder: Path, document: RunsFile[Any]) -> bool:
    """Tell whether a folder holds runs with this very run.json; False: it is still to be made.

    Raises:
        InputError: it holds something else; names the first setting that differs.
    """
    if not present(folder):
        check_new(folder)
        return False
    if not present(folder / RUN_FILE):
        raise InputError(f"{folder}: exists already and holds no Monte Carlo ({RUN_FILE}); give a new name")
    check_configuration(folder / RUN_FILE, document, "runs")
    return True


def raise_runs(folder: Path, document: RunsFile[MonteCarloSettings]) -> None:
    """Ask for more runs in a folder that holds fewer of the same kind; leave every other folder alone.

    A run depends on its number and the seed alone, so those that are there stay. A last file that was not
    full is made again.

    Raises:
        InputError: another process is at work in the folder, or it cannot be written.
    """
    if not present(folder / RUN_FILE):
        return
    try:
        there = RunsFile[MonteCarloSettings].read(folder / RUN_FILE)
    except InputError:  # `check_folder` says what it is
        return
    settings, asked = there.settings, document.settings
    raised = there.model_copy(update={"settings": settings.model_copy(update={"runs": asked.runs})})
    same = raised.model_copy(update={"machine": document.machine}).plain() == document.plain()
    if settings.runs >= asked.runs or not same:
        return
    with alone_on(folder):
        if left := settings.runs % settings.chunk:
            chunks = Chunks(folder / CHUNK_FOLDER, settings.runs, settings.chunk)
            chunks.path((settings.runs - left) // settings.chunk).unlink(missing_ok=True)
        raised.write(folder / RUN_FILE)


@contextmanager
def open_folder(folder: Path, document: RunsFile[Any], plan: PosturePlan) -> Iterator[Path]:
    """Make the folder with its plan, unless it is there, and keep others out; yields where the chunks lie.

    Raises:
        InputError: it holds something else, cannot be written, or another process is at work in it.
    """
    if not check_folder(folder, document):
        with new_folder(folder) as working:
            (working / CHUNK_FOLDER).mkdir()
            write_plan(working / PLAN_FOLDER, plan)
            document.write(working / RUN_FILE)
    with alone_on(folder):
        yield folder / CHUNK_FOLDER
