"""Preflight of a measurement folder: what is missing, what is wrong, and what to do about it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.errors import MOST_LISTED, InputError, listed, shortened, warn
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.calibration.families import check_tolerances
from tulip_testbed.calibration.usual_changes import usual_changes
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.removal import without
from tulip_testbed.experiments.example import example_manifest, example_row
from tulip_testbed.experiments.preflight_tables import advice_table, complaint_lines, finding_table
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.preflight import RESULTS, Finding, preflight, worst_of
from tulip_testbed.identification.preflight.plate_checks import plate_poses
from tulip_testbed.identification.regressor import check_robot
from tulip_testbed.measurements import Measurements, Series, read_measurements, read_series
from tulip_testbed.measurements.folder_kind import check_kind
from tulip_testbed.measurements.measurement_folder import read_manifest
from tulip_testbed.measurements.survey import complaints
from tulip_testbed.sim.robot import Robot

UNREADABLE = "could not read"


@dataclass(frozen=True, repr=False)
class Preflight(Shown):
    """The result of a preflight as its JSON document: verdict, counts and every check."""

    document: dict[str, Any]

    @property
    def verdict(self) -> str:
        """ "pass", "warn", "fail" or "could not read"."""
        return self.document["verdict"]

    def parts(self) -> list[Table | str]:
        """Return the checks and what to do about them; of a folder that cannot be read what it lacks."""
        if self.verdict == UNREADABLE:
            return list(complaint_lines(self.document))
        checks = self.document["checks"]
        advice = advice_table(checks)
        return [finding_table(checks), *([advice] if advice.rows else []), f"Verdict: {self.verdict}"]


def check_folder(folder: Path, robot: Robot, corrections: Sequence[EffectInstance] = ()) -> Preflight:
    """Check a measurement folder for faults, and for what it lacks.

    Args:
        corrections: effects that the measurements are corrected for before.

    Raises:
        InputError: no such folder, a broken robot, or a folder that cannot be read for a reason
            other than missing columns and keys.
    """
    folder = Path(folder)
    check_kind(folder, "measurement")
    nominal = nominal_robot(robot)
    _refuse_other_robot(folder, nominal)
    wrong = complaints(folder, nominal.parameters.tree.joints)
    wrong["manifest"] += _wrong_tolerances(folder)
    if any(wrong.values()):
        return Preflight(
            {
                "verdict": UNREADABLE,
                "complaints": wrong,
                "example_manifest": example_manifest(robot),
                "example_row": example_row(robot),
            }
        )
    measurements = read_measurements(folder, likely=False)
    return check_measurements(measurements, robot, corrections, read_series(folder), str(folder))


def check_measurements(
    measurements: Measurements,
    robot: Robot,
    corrections: Sequence[EffectInstance] = (),
    series: Series | None = None,
    source: str = "measurements",
) -> Preflight:
    """Check measurements for faults.

    Args:
        corrections: see `check_folder`. series: raw readings within the windows, if there are any.
        source: of the measurements, for messages.

    Raises:
        InputError: corrections for measurements that do not fit the robot; tolerances of unknown families.
    """
    check_tolerances(measurements.tolerances, f"{source}: key 'tolerances'")
    nominal = nominal_robot(robot)
    if not corrections:
        findings = preflight(measurements, nominal, series, partial(usual_changes, measurements, nominal))
        return Preflight(findings_document(measurements, nominal, findings))
    check_robot(nominal.parameters, measurements, robot, source)
    corrected, _ = without(measurements, nominal, corrections)
    findings = preflight(corrected, nominal, series, partial(usual_changes, corrected, nominal))
    # Of the records of the plates: corrected ones hold what moves the centre of pressure otherwise.
    recorded = plate_poses(measurements)
    return Preflight(
        findings_document(
            corrected,
            nominal,
            [recorded if finding.name == recorded.name else finding for finding in findings],
        )
    )


def _wrong_tolerances(folder: Path) -> list[str]:
    """List the tolerances of the manifest that no family can have."""
    try:
        tolerances = read_manifest(folder).tolerances or {}
    except InputError:
        return []  # the other complaints come first
    found = []
    for name, value in tolerances.items():
        try:
            check_tolerances({name: value}, f"{folder / 'manifest.json'}: key 'tolerances'")
        except InputError as error:
            found.append(str(error))
    return found[:MOST_LISTED]


def warn_of_faults(
    measurements: Measurements,
    robot: Robot,
    corrections: Sequence[EffectInstance] = (),
    source: str | None = None,
    tolerances: Mapping[str, float] | None = None,
) -> None:
    """Warn of measurements that fail the preflight.

    Args:
        corrections: see `check_folder`. source: folder of the measurements.
        tolerances: of families, in place of those of the measurements and those that fit the sensors [SI].

    Raises:
        InputError: measurements that do not fit the robot.
    """
    nominal = nominal_robot(robot)
    check_robot(nominal.parameters, measurements, robot, source or "measurements")
    if corrections:
        measurements, _ = without(measurements, nominal, corrections)
    usual = partial(usual_changes, measurements, nominal, tolerances)
    findings = preflight(measurements, nominal, usual_changes=usual)
    if faults := [finding for finding in findings if finding.result == "fail"]:
        call = f"`tt.check({'measurements' if source is None else repr(source)})`"
        warn(
            f"{source or 'measurements'}: found faults in {listed(repr(f.name) for f in faults)}; "
            f"{call} says more"
        )


def _refuse_other_robot(folder: Path, nominal: Nominal) -> None:
    """Another robot's folder would lack column after column; name the robot instead.

    Raises:
        InputError: another model, by its hash or else by its name, and other joints.
    """
    try:
        manifest = read_manifest(folder)
    except InputError:
        return  # the complaints say more
    robot, joints = nominal.robot, nominal.parameters.tree.joints
    sha256, model = manifest.robot.sha256, manifest.robot.model
    other = model != robot.model_file.name if sha256 is None else sha256.lower() != robot.model_hash
    if other and set(manifest.joints) != set(joints):
        raise InputError(
            f"{folder / 'manifest.json'}: found robot '{shortened(model)}' with other joints, "
            f"expected {robot.model_file.name} of {robot.name}; give the robot that was measured"
        )


def findings_document(
    measurements: Measurements, nominal: Nominal, findings: list[Finding]
) -> dict[str, Any]:
    results = [finding.result for finding in findings]
    return {
        "verdict": worst_of([result for result in results if result != "not evaluated"]),
        "robot": nominal.robot.model_file.name,
        "postures": len(np.unique(measurements.posture)),
        "rows": len(measurements),
        "placements": len(np.unique(measurements.placement)),
        "counts": {result: results.count(result) for result in RESULTS},
        "checks": [dataclasses.asdict(finding) for finding in findings],
    }
