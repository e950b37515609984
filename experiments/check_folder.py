"""Preflight of a measurement folder: what is missing, what is wrong, and what to do about it."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tulip_testbed.base.errors import MOST_LISTED, FaultyError, InputError, listed, shortened, warn
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Cell, Table, Verbatim
from tulip_testbed.calibration.families import check_tolerances
from tulip_testbed.calibration.usual_changes import usual_changes
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.removal import without
from tulip_testbed.experiments.example import example_manifest, example_row
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.identification.preflight.finding import RESULTS, Finding, worst_of
from tulip_testbed.identification.preflight.motion_checks import rows_of, samples_of
from tulip_testbed.identification.preflight.stance_checks import plate_poses
from tulip_testbed.identification.preflight.units import units
from tulip_testbed.identification.regressor import check_robot
from tulip_testbed.measurements import Measurements, Series, read_measurements, read_samples, read_series
from tulip_testbed.measurements.folder_kind import check_kind
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import MAY_LACK, read_manifest
from tulip_testbed.measurements.survey import complaints
from tulip_testbed.sim.robot import Robot

UNREADABLE = "could not read"
NOT_EVALUATED = "not evaluated"


@dataclass(frozen=True, repr=False)
class Preflight(Result):
    """The result of a preflight.

    Attributes:
        verdict: "pass", "warn", "fail" or "could not read".
        robot: model file of the nominal robot. postures, rows, placements: how many there are.
        counts: of checks by their result. checks: all of them.
        complaints: of "manifest" and "table" of a folder that could not be read; then there are no checks,
            but examples of a manifest and of a row of the table.
    """

    exit_codes: ClassVar = {"fail": 1, UNREADABLE: 2}
    verdict: str
    robot: str
    postures: int = 0
    rows: int = 0
    placements: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    checks: tuple[Finding, ...] = ()
    complaints: dict[str, list[str]] | None = None
    example_manifest: dict[str, Any] | None = None
    example_row: dict[str, float] | None = None

    def tables(self) -> list[Table | str]:
        if self.complaints is not None:
            return self._lacks(self.complaints)
        evaluated = [check for check in self.checks if check.result != NOT_EVALUATED]
        both = [(check, Cell(check.result, check.result)) for check in evaluated]
        rows = [[check.name, result, check.seen, check.expected] for check, result in both]
        parts: list[Table | str] = [Table("Preflight", ("check", "result", "found", "expected"), rows)]
        faulty = ("warn", "fail")
        if rows := [[c.name, result, c.where, c.advice] for c, result in both if c.result in faulty]:
            parts.append(Table("Advice", ("check", "result", "where", "what to do"), rows))
        skipped: dict[str, list[str]] = {}
        for check in self.checks:
            if check.result == NOT_EVALUATED:
                skipped.setdefault(check.seen, []).append(check.name)
        parts += [f"Not evaluated: {', '.join(names)} ({reason})." for reason, names in skipped.items()]
        parts.append(f"{self.rows} rows of {self.postures} postures on {self.placements} placements.")
        return [*parts, f"Verdict: {self.verdict} ({counts_line(self.counts)})"]

    def _lacks(self, found: dict[str, list[str]]) -> list[Table | str]:
        lines = ["This folder cannot be read yet:"]
        lines += [f"  - {text}" for text in (*found["manifest"], *found["table"])]
        if found["manifest"]:
            entries = [f" {json.dumps(k)}: {json.dumps(v)}" for k, v in (self.example_manifest or {}).items()]
            lines += [
                *("", "An example manifest.json for this robot; replace every null that you know:"),
                *("{", *",\n".join(entries).splitlines(), "}"),
            ]
        if found["table"]:
            row = self.example_row or {}
            lines += [
                "",
                "An example postures.csv with one posture, all joints at zero (rad, N, m):",
                ",".join(row),
                ",".join(f"{value:g}" for value in row.values()),
                "",
                f"These columns are optional: {', '.join(MAY_LACK)}.",
            ]
        lines += ["", "docs/how-to/your-data.md explains the format step by step."]
        return [Verbatim(line) for line in lines]


def check_folder(folder: Path, robot: Robot, corrections: Sequence[EffectInstance] = ()) -> Preflight:
    """Check a measurement folder, corrected for known effects, for faults and for what it lacks."""
    folder = Path(folder)
    check_kind(folder, "measurement")
    joints, manifest = nominal_robot(robot).parameters.tree.joints, None
    with suppress(InputError):  # the complaints say more
        manifest = read_manifest(folder)
    if manifest is not None:
        _refuse_other_robot(folder, manifest, robot, joints)
    wrong = complaints(folder, joints)
    if manifest is not None:
        wrong["manifest"] += _wrong_tolerances(folder, manifest)
    if any(wrong.values()):
        return Preflight(
            UNREADABLE,
            robot.model_file.name,
            complaints=wrong,
            example_manifest=example_manifest(robot),
            example_row=example_row(robot),
        )
    measurements, samples = read_measurements(folder, likely=False), read_samples(folder, likely=False)
    return check_measurements(measurements, robot, corrections, read_series(folder), str(folder), samples)


def check_measurements(
    measurements: Measurements,
    robot: Robot,
    corrections: Sequence[EffectInstance] = (),
    series: Series | None = None,
    source: str = "measurements",
    samples: Measurements | None = None,
) -> Preflight:
    """Check measurements for faults.

    Args:
        corrections: see `check_folder`. series: raw readings within the windows, if there are any.
        samples: of which the measurements are the rows, of a robot that moves.
    """
    check_tolerances(measurements.tolerances, f"{source}: key 'tolerances'")
    nominal = nominal_robot(robot)
    corrected = measurements
    if corrections:
        check_robot(nominal.parameters, measurements, robot, source)
        corrected, _ = without(measurements, nominal, corrections)
    findings = preflight(corrected, nominal, series, partial(usual_changes, nominal=nominal))
    if corrections:  # corrected records of the plates hold what moves the centre of pressure otherwise
        recorded = plate_poses(measurements)
        findings = [recorded if finding.name == recorded.name else finding for finding in findings]
    held = corrected.joint_rates is None or corrected.joint_accelerations is None
    if not held and corrected.joints == nominal.parameters.tree.joints:
        findings += [] if samples is None else samples_of(samples, float(corrected.window[0]))
        findings += rows_of(corrected, nominal)
    results = [finding.result for finding in findings]
    return Preflight(
        verdict=worst_of([result for result in results if result != NOT_EVALUATED]),
        robot=robot.model_file.name,
        postures=len(np.unique(corrected.posture)),
        rows=len(corrected),
        placements=len(np.unique(corrected.placement)),
        counts={result: results.count(result) for result in RESULTS},
        checks=tuple(findings),
    )


def _wrong_tolerances(folder: Path, manifest: Manifest) -> list[str]:
    """List the tolerances of the manifest that no family can have."""
    found = []
    for name, value in (manifest.tolerances or {}).items():
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
    refuse: str = "",
) -> None:
    """Refuse measurements in wrong units, and warn of others that fail the preflight.

    All measurements that a user gives to a function pass here, whether in memory or as a folder.

    Args:
        corrections: see `check_folder`. source: folder of the measurements.
        tolerances: of families, in place of those of the measurements and those that fit the sensors [SI].
        refuse: how to go on with gross faults, which are refused then; "": they are not.

    Raises:
        InputError: measurements that do not fit the robot or are in wrong units, tolerances of unknown
            families or impossible ones.
        FaultyError: gross faults, if those are refused.
    """
    nominal, source = nominal_robot(robot), source or "measurements"
    check_tolerances(measurements.tolerances, f"{source}: key 'tolerances'")
    check_tolerances(tolerances or {})
    check_robot(nominal.parameters, measurements, robot, source)
    in_units = units(measurements, nominal)
    if in_units.result == "fail":
        raise InputError(f"{source}: found {in_units.seen}; expected {in_units.expected}; `check` says more")
    if corrections:
        measurements, _ = without(measurements, nominal, corrections)
    usual = partial(usual_changes, nominal=nominal, tolerances=tolerances)
    findings = preflight(measurements, nominal, usual_changes=usual)
    gross = "; ".join(f"'{one.name}': {one.seen}" for one in findings if one.gross)
    if refuse and gross:
        raise FaultyError(
            f"{source}: found gross faults, which no effect explains ({gross}); "
            f"expected none: correct them as `check` advises, or {refuse}"
        )
    if faults := [finding for finding in findings if finding.result == "fail"]:
        names = listed(repr(finding.name) for finding in faults)
        words = f", gross ones, which no effect explains ({gross}): no result holds until these are corrected"
        warn(f"{source}: found faults in {names}{words if gross else ''}; `check` says more")


def _refuse_other_robot(folder: Path, manifest: Manifest, robot: Robot, joints: tuple[str, ...]) -> None:
    """Another robot's folder would lack column after column; name the robot instead."""
    sha256, model = manifest.robot.sha256, manifest.robot.model
    other = model != robot.model_file.name if sha256 is None else sha256.lower() != robot.model_hash
    if other and set(manifest.joints) != set(joints):
        raise InputError(
            f"{folder / 'manifest.json'}: found robot '{shortened(model)}' with other joints, "
            f"expected {robot.model_file.name} of {robot.name}; give the robot that was measured as `robot`"
        )


def counts_line(counts: Mapping[str, int]) -> str:
    """Return how many checks were evaluated, and how many of them had which result."""
    some = {result: count for result, count in counts.items() if count}
    every = sum(some.values())
    evaluated = every - some.pop(NOT_EVALUATED, 0)
    results = ", ".join(f"{count} {result}" for result, count in some.items())
    return f"{evaluated} of {every} checks evaluated: {results}"
