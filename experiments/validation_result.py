"""The result of a validation: estimates, the truth, checks and the verdict."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.machine import machine
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import software
from tulip_testbed.experiments.checks import Check, check_table, verdict
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table
from tulip_testbed.experiments.estimate_report import model_report
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    mass_line,
    models,
    parameter_table,
    read_reported,
)
from tulip_testbed.experiments.run_file import VERSION, Configuration, RunFile, configuration_of
from tulip_testbed.experiments.run_summary import (
    balance_line,
    imperfections_line,
    sag_line,
    usable_postures,
    worst_balance,
)
from tulip_testbed.experiments.truth_record import truth_of
from tulip_testbed.experiments.validation_record import MODELS, Report, ValidationRecord, write_validation


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Result):
    """A run compared with its truth; prints parameters, checks and the verdict.

    Attributes:
        run: the experiment. identification: the estimates from its measurements, which are judged.
        least_squares: the paper's estimates from the same measurements; None where they cannot be used.
        truth: base parameters of the robot that stood there, (p,) [m].
        checks: what was judged. wall_s: wall time [s].
        imperfections: scale of those that were drawn for the laboratory; 0: it is exact.
    """

    run: Run
    identification: Identification
    least_squares: Identification | None
    truth: np.ndarray
    checks: tuple[Check, ...]
    wall_s: float
    imperfections: float = 0.0

    @property
    def verdict(self) -> str:
        """ "pass", or "fail" if any check fails."""
        return verdict(list(self.checks))

    def table(self) -> Table:
        """Return the checks, one per row."""
        return check_table([dataclasses.asdict(check) for check in self.checks])

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per parameter of the full model, with its truth.

        The checks are plain records: `pandas.DataFrame(validation.checks)`.
        """
        found = self.identification
        table = parameter_table("full", model_report(found.full, self.truth).plain(), found.parameters)
        return table.frame().set_index("parameter")

    @property
    def exit_code(self) -> int:
        """Return 0 for a pass, 1 for a failed check."""
        return 0 if self.verdict == "pass" else 1

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document, which `--json` prints and report.json holds."""
        return report_of(self).plain()

    def save(self, folder: str | Path) -> None:
        """Write a new run folder, which appears whole or not at all.

        Raises:
            InputError: the folder exists or cannot be written.
        """
        write_validation(Path(folder), validation_record(self))

    def tables(self) -> list[Table | str]:
        """Return the parameters of the models, how the experiment went, the checks and the verdict."""
        document, run, parameters = self.to_json(), self.run, self.identification.parameters
        robot, angles = run.laboratory.robot, run.measurements.joint_angles
        parts: list[Table | str] = []
        plain = document["least_squares"] or {}
        where = "least_squares." if plain else ""
        dropped = [reason for _, reason in run.truth.dropped]
        for model in models(robot):
            # Eq. 15 is of least squares: priors of imperfections would hide what postures do not distinguish.
            pairs = plain.get(model, document[model])["correlations"]
            parts += [
                parameter_table(
                    model, document[model], parameters, read_reported(robot), least_squares=plain.get(model)
                ),
                correlation_table(model, pairs, parameters, angles, where) if pairs else NO_CORRELATION,
                "",
            ]
        mass = document["total_mass"]
        parts += [
            LEGEND,
            imperfections_line(self.imperfections),
            *usable_postures(len(run.plan), len(run.measurements), dropped, robot.settings.get("paper")),
        ]
        parts.append(mass_line(mass["estimate"], mass["standard_error"], mass["truth"]))
        if document["books"] is not None:
            parts += [sag_line(run.truth), balance_line(document["books"])]
        verdict = f"Verdict: {self.verdict} after {self.wall_s:.0f} s"
        return [*parts, "", self.table(), verdict]


def report_of(result: Validation) -> Report:
    """Report a validation."""
    found, plain, run = result.identification, result.least_squares, result.run
    dropped = run.truth.dropped
    return Report.model_validate(
        {
            "verdict": result.verdict,
            "estimator": found.estimator,
            "checks": [dataclasses.asdict(check) for check in result.checks],
            "postures_planned": run.plan.postures,
            "postures_used": run.plan.postures - len(dropped),
            "rows_measured": len(run.measurements),
            "dropped": [{"posture": posture, "reason": reason} for posture, reason in dropped],
            "condition_number": found.full.condition_number,
            "total_mass": {
                "truth": run.truth.mass,
                "estimate": found.mass[0],
                "standard_error": found.mass[1],
            },
            "full": model_report(found.full, result.truth),
            "simplified": model_report(found.simplified, result.truth),
            "least_squares": plain and {m: model_report(getattr(plain, m), result.truth) for m in MODELS},
            "books": worst_balance(run.truth),
            "wall_s": result.wall_s,
            "imperfections": float(result.imperfections),
        }
    )


def validation_record(result: Validation) -> ValidationRecord:
    """Make the record of a validation that has just been carried out."""
    run, found = result.run, result.identification
    return ValidationRecord(
        document=RunFile[Configuration](
            format="tulip-run",
            version=VERSION,
            command="validate",
            configuration=configuration_of(
                run.laboratory, run.plan, run.seed, run.engine, result.imperfections
            ),
            software=software(),
            machine=machine(),
            inputs=run.laboratory.robot.hashes,
        ),
        report=report_of(result),
        truth=truth_of(run),
        plan=run.plan,
        measurements=run.measurements,
        residual_mm={
            model: 1e3 * np.linalg.norm(getattr(found, model).residual.reshape(-1, 2), axis=1)
            for model in MODELS
        },
        robot=run.laboratory.robot,
    )
