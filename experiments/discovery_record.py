"""The record of a discovery and its folder: run.json, discovery.json, story, residuals, measurements, rig."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from tulip_testbed.base.document import Document, Seed
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import new_folder, read_bytes, read_text, write_text
from tulip_testbed.base.machine import machine
from tulip_testbed.base.table_files import Table, software
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.lasting import everywhere
from tulip_testbed.experiments.discovery_report import DiscoveryReport, discovery_report
from tulip_testbed.experiments.findings import Findings
from tulip_testbed.experiments.proposed_experiment import Proposals, propose_experiments
from tulip_testbed.experiments.rig_folder import RIG, rig_files
from tulip_testbed.experiments.run_file import (
    MEASUREMENT_FOLDER,
    RUN_FILE,
    VERSION,
    RunFile,
    check_outputs,
    check_parameters,
    check_robot,
    check_rows,
    run_kind,
    write_run_file,
)
from tulip_testbed.identification.base_parameters import base_parameters, common_support
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.joined import read_written, write_experiments
from tulip_testbed.sim.robot import Robot

REPORT_FILE, RESIDUAL_FILE, STORY_FILE = "discovery.json", "residuals.csv", "story.txt"
NEEDED = (REPORT_FILE, RESIDUAL_FILE, STORY_FILE)
SIDES = ("before", "after")
PARTS = (
    *("cop_x_m", "cop_y_m", "force_N", "twist_right_N", "twist_left_N"),
    *("height_m", "roll_rad", "pitch_rad", "x_m", "y_m", "yaw_rad"),
)


class DiscoveryConfiguration(Document):
    """The inputs of a discovery; measurements: their folder."""

    measurements: str
    robot: str
    seed: Seed | None = None
    no_check: bool | None = None


@dataclass(frozen=True)
class DiscoveryRecord:
    """A discovery as its folder holds it.

    Attributes:
        document: run.json. report: discovery.json.
        before, after: residuals of every posture as measured and with what was found removed, (m, 11), as
            `identification.residual_channels` has them.
        rig: files of the adopted model's rig folder, as text by name; empty: nothing was adopted.
        folder: None: in memory alone.
    """

    kind: ClassVar[str] = "discovery"
    document: RunFile[DiscoveryConfiguration]
    report: DiscoveryReport
    measurements: Measurements
    before: np.ndarray
    after: np.ndarray
    rig: dict[str, str]
    robot: Robot
    folder: Path | None = None

    def propose(self, plan: PosturePlan | None = None, seed: int = 0) -> Proposals:
        """Rank the experiments that would settle what is ambiguous, see `propose_experiments`."""
        placements = np.unique(self.measurements.placement).tolist()
        where = f"{self.folder}: candidates"
        explanations = [
            Explanation(
                EffectInstance.from_document(candidate.effect, self.robot, where, placements),
                candidate.log_bayes_factor,
                candidate.gap,
            )
            for candidate in self.report.candidates
        ]
        verdict = self.report.verdict
        return propose_experiments(self.measurements, self.robot, verdict, explanations, plan, seed)


def discovery_record(
    result: Findings,
) -> DiscoveryRecord:
    """Make the record of a discovery that has just been carried out."""
    found, robot = result.discovery, result.robot
    return DiscoveryRecord(
        document=RunFile[DiscoveryConfiguration](
            format="tulip-run",
            version=VERSION,
            command="discover",
            configuration=DiscoveryConfiguration(
                measurements=result.source,
                robot=robot.path.name,
                seed=result.seed,
                no_check=result.no_check,
            ),
            software=software(),
            machine=machine(),
            inputs=robot.hashes,
        ),
        report=discovery_report(result),
        measurements=found.observed.measurements,
        before=residuals(found.observed, found.selection.null.linear.theta),
        after=residuals(found.fit.linear.observed, found.fit.linear.theta),
        rig=rig_files(robot, lasting) if (lasting := _lasting(found.corrections)) else {},
        robot=robot,
    )


def _lasting(found: Sequence[EffectInstance]) -> list[EffectInstance]:
    """Return the effects that hold in experiments to come too, rather than in one session."""
    return [one for one in found if everywhere(one.target)]


def write_discovery(folder: Path, record: DiscoveryRecord) -> DiscoveryRecord:
    """Write a discovery; the folder appears whole or not at all.

    Returns:
        the record as it is in the folder.

    Raises:
        InputError: the folder exists or cannot be written.
    """
    folder = Path(folder)
    report = record.report.model_copy(update={"rig": str(folder / RIG) if record.rig else None})
    with new_folder(folder) as working:
        write_experiments(working / MEASUREMENT_FOLDER, record.measurements)
        report.write(working / REPORT_FILE)
        write_text(working / STORY_FILE, "\n".join(report.story) + "\n")
        _write_residuals(working / RESIDUAL_FILE, record)
        for name, text in record.rig.items():
            write_text(working / RIG / name, text)
        document = write_run_file(working, record.document)
    return replace(record, document=document, report=report, folder=folder)


def read_discovery(folder: Path, robot: Robot) -> DiscoveryRecord:
    """Read a discovery and check that its files are what was written and fit each other.

    Raises:
        InputError: another kind or version of run, another robot's, or a file that is not what was written.
    """
    folder = Path(folder)
    if (kind := run_kind(folder)) != "discovery":
        raise InputError(f"{folder}: found the run folder of a {kind}, expected that of a discovery")
    document = RunFile[DiscoveryConfiguration].read(folder / RUN_FILE)
    check_robot(folder, document.inputs, robot)
    check_outputs(folder, document.outputs, NEEDED)
    report = DiscoveryReport.read(folder / REPORT_FILE)
    measurements = read_written(folder / MEASUREMENT_FOLDER)
    parameters = base_parameters(robot, support=common_support(measurements.support))
    check_parameters(
        folder / REPORT_FILE,
        "parameters",
        [(row.number, row.name) for row in report.parameters],
        list(enumerate(parameters.names, 1)),
    )
    table = Table(folder / RESIDUAL_FILE, read_bytes(folder / RESIDUAL_FILE))
    check_rows(folder / RESIDUAL_FILE, len(table), measurements)
    rig = [path for path in map(Path, document.outputs) if path.parent == Path(RIG)]
    return DiscoveryRecord(
        document=document,
        report=report,
        measurements=measurements,
        before=table.matrix("before", PARTS),
        after=table.matrix("after", PARTS),
        rig={path.name: read_text(folder / path) for path in rig},
        robot=robot,
        folder=folder,
    )


def _write_residuals(path: Path, record: DiscoveryRecord) -> None:
    """Write the residuals of every posture, before and after."""
    measured = record.measurements
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = [f"{side}.{part}" for side in SIDES for part in PARTS]
        writer.writerow(["posture", "placement", "time", *columns])
        for k in range(len(measured)):
            values = [*record.before[k].tolist(), *record.after[k].tolist()]
            row = [int(measured.posture[k]), int(measured.placement[k]), float(measured.time[k])]
            writer.writerow([*row, *values])
