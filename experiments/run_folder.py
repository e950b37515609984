"""Run folders: what was set, with which versions, and everything that came out."""

from __future__ import annotations

import csv
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.experiments.laboratory import Run, configuration, truth_document
from tulip_testbed.experiments.validate import Validation, report_document
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.files import new_folder, present
from tulip_testbed.sim.measurements import write_measurements, write_plan
from tulip_testbed.sim.measurements.table_files import software, write_json
from tulip_testbed.sim.robot import sha256


def check_new(path: Path) -> None:
    """Say before the work, not after it, that its result could not be written.

    Raises:
        InputError: the path exists, or lies where nothing can be written.
    """
    path = Path(path)
    real = Path(os.path.realpath(path))
    if present(path) or real.exists():
        raise InputError(f"{path}: exists already; give a new name")
    parent = next(folder for folder in real.parents if folder.exists())
    try:
        os.rmdir(tempfile.mkdtemp(dir=parent, prefix=f".{path.name}.", suffix=".partial"))
    except OSError as error:
        raise InputError(f"{path}: cannot write into {parent} ({error.strerror})") from None


def write_run(folder: Path, result: Validation) -> None:
    """Write a validation; the folder appears whole or not at all.

    run.json (settings, versions, hashes), report.json, truth.json, the plan, the measurements
    and the tables parameters.csv and residuals.csv.
    """
    with new_folder(folder) as working:
        write_plan(working / "plan", result.run.plan)
        write_measurements(working / "measurements", result.run.measurements)
        report = report_document(result)
        write_json(working / "report.json", report)
        write_json(working / "truth.json", truth_document(result.run))
        _write_csv(working / "parameters.csv", _parameter_rows(report))
        _write_csv(working / "residuals.csv", _residual_rows(result))
        run = result.run
        outputs = sorted(path for path in working.rglob("*") if path.is_file())
        write_json(
            working / "run.json",
            {
                "format": "tulip-run",
                "version": 1,
                "command": "validate",
                "configuration": configuration(run.laboratory, run.plan, run.seed, run.engine),
                "software": software(),
                "inputs": run.laboratory.robot.hashes,
                "outputs": {str(path.relative_to(working)): sha256(path) for path in outputs},
            },
        )


def write_experiment(out: Path, truth: Path | None, run: Run) -> None:
    """Write the truth and the measurement folder; where the folder stands, its truth stands too."""
    if truth is not None:
        write_json(truth, truth_document(run))
    try:
        write_measurements(out, run.measurements)
    except InputError:
        if truth is not None:
            truth.unlink()
        raise


def _parameter_rows(report: dict[str, Any]) -> list[dict[str, Any]]:
    return [{"model": model} | row for model in ("full", "simplified") for row in report[model]["parameters"]]


def _residual_rows(result: Validation) -> list[dict[str, Any]]:
    norms = {
        model: 1e3 * np.linalg.norm(getattr(result.identification, model).residual.reshape(-1, 2), axis=1)
        for model in ("full", "simplified")
    }
    measured = result.run.measurements
    return [
        {
            "posture": int(measured.posture[k]),
            "placement": int(measured.placement[k]),
            "full_mm": float(norms["full"][k]),
            "simplified_mm": float(norms["simplified"][k]),
        }
        for k in range(len(measured))
    ]


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
