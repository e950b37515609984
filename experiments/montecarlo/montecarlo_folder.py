"""The folder of a Monte Carlo: begun once, resumed by the same command, never mixed with another."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tulip_testbed.experiments.laboratory import Laboratory, configuration
from tulip_testbed.experiments.run_folder import check_new
from tulip_testbed.sim.errors import InputError, shortened
from tulip_testbed.sim.files import new_folder, present
from tulip_testbed.sim.measurements import PosturePlan, write_plan
from tulip_testbed.sim.measurements.table_files import read_json, software, write_json

RUN_FILE, CHUNK_FOLDER, REPORT_FILE, PLAN_FOLDER = "run.json", "runs", "report.json", "plan"


def run_document(
    laboratory: Laboratory, plan: PosturePlan, seed: int, engine: str, settings: dict[str, Any]
) -> dict[str, Any]:
    """Write run.json: everything that the results depend on.

    Args:
        seed, engine: see `Laboratory.run`. settings: of the Monte Carlo itself.
    """
    document = {
        "format": "tulip-montecarlo",
        "version": 1,
        "command": "montecarlo",
        "settings": settings,
        "configuration": configuration(laboratory, plan, seed, engine),
        "inputs": laboratory.robot.hashes | {"plan": plan_hash(plan)},
        "software": software(),
    }
    return json.loads(json.dumps(document))  # as it will be read again


def plan_hash(plan: PosturePlan) -> str:
    """Of all that a plan asks for, in hexadecimal."""
    digest = hashlib.sha256()
    for name in ("joint_angles", "posture", "placement", "support", "swing_pose"):
        array = getattr(plan, name)
        digest.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()


def check_folder(folder: Path, document: dict[str, Any]) -> bool:
    """Whether the folder holds runs of this very Monte Carlo; False: it is still to be made.

    Raises:
        InputError: it holds something else; names the first setting that differs.
    """
    if not present(folder):
        check_new(folder)
        return False
    if not present(folder / RUN_FILE):
        raise InputError(f"{folder}: exists already and holds no Monte Carlo ({RUN_FILE}); give a new name")
    found = read_json(folder / RUN_FILE)
    if (other := first_difference(found, document)) is not None:
        name, there, here = other
        raise InputError(
            f"{folder}: holds runs of another configuration: {name} is {shortened(repr(there))} there and "
            f"{shortened(repr(here))} here; give a new name"
        )
    return True


def first_difference(there: Any, here: Any, name: str = "") -> tuple[str, Any, Any] | None:
    """The first value in which two JSON documents differ: its name with dots, both values."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in [*here, *(key for key in there if key not in here)]:
            inner = first_difference(there.get(key), here.get(key), f"{name}.{key}" if name else key)
            if inner is not None:
                return inner
        return None
    return None if there == here else (name, there, here)


@contextmanager
def open_folder(folder: Path, document: dict[str, Any], plan: PosturePlan) -> Iterator[Path]:
    """Make the folder with its plan, unless it is there, and keep others out; yields where the chunks lie.

    Raises:
        InputError: it holds something else, cannot be written, or another process is at work in it.
    """
    if not check_folder(folder, document):
        with new_folder(folder) as working:
            (working / CHUNK_FOLDER).mkdir()
            write_plan(working / PLAN_FOLDER, plan)
            write_json(working / RUN_FILE, document)
    lock = os.open(folder / RUN_FILE, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            # Freed by the system however the process ends.
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder}: another process is at work in it") from None
        except OSError:  # some network file systems cannot lock
            pass
        yield folder / CHUNK_FOLDER
    finally:
        os.close(lock)
