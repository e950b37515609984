"""The preflight: checks of a measurement folder for faults."""

from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.noise_in_time import apart
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.preflight import (
    agreement,
    cell_wiring,
    readings,
    settling,
    stance_checks,
    units,
)
from tulip_testbed.identification.preflight import weight as forces
from tulip_testbed.identification.preflight.excitation import identifiable
from tulip_testbed.identification.preflight.finding import Finding, row_name, skipped
from tulip_testbed.identification.preflight.usual import Usual, UsualChanges, exact
from tulip_testbed.identification.reading_noise import ReadingNoise, reading_noise
from tulip_testbed.identification.regressor import regression
from tulip_testbed.measurements import Measurements, Series

FORCES = (
    *("wiring of cells", "load inside soles", "repeats"),
    *("single postures", "single placements", "scatter about the model"),
)
LEGS = ("feet on plates", "legs close", "feet stay")
APART = 4.0  # s, between rows of a moving record: twice as long as the noise of cells usually lasts
READINGS = (
    *("joint limits", "stuck readings", "cell loads", "stated noise", "steady windows", "settling"),
    *("series and table", "weight balance", "constant weight", "drift", "plate poses"),
)


def preflight(
    measurements: Measurements,
    nominal: Nominal,
    series: Series | None = None,
    usual_changes: UsualChanges = exact,
) -> list[Finding]:
    """Run every check, in the order in which a laboratory should correct the faults.

    Args:
        series: raw readings within the windows, if there are any.
        usual_changes: by ordinary imperfections, of measurements of this robot in plausible units.
    """
    m = measurements
    findings = [units.same_robot(m, nominal)]
    rest = (*READINGS, *LEGS, *FORCES, "identifiable")
    if m.joints != nominal.parameters.tree.joints:
        return [*findings, *_skip(("units", *rest), "correct the joints first: they are not the robot's")]
    found = units.units(m, nominal)
    if found.result == findings[0].result == "fail":
        reason = "correct the robot first"
        return [*findings, *_skip(("units",), f"{reason}: by this one {found.seen}"), *_skip(rest, reason)]
    findings.append(found)
    if found.result == "fail":
        return [*findings, *_skip(rest, "correct the units first")]
    if m.contacts is not None:
        some = _independent(m, nominal)
        return [*findings, *_of_wrenches(m, some, nominal, usual_changes(some))]
    loads, some = readings.cell_loads(m), _independent(m, nominal)
    # Cells whose loads are wrong say nothing about how much yields: as if both feet bore the same.
    level = np.full_like(some.cell_forces, np.median(m.cell_forces.sum(axis=1)) / m.cell_forces.shape[1])
    usual = usual_changes(replace(some, cell_forces=level) if loads.result == "fail" else some)
    findings += [
        units.joint_limits(m, nominal),
        readings.stuck(m, nominal),
        loads,
        readings.resolution(m),
        settling.steady_windows(m),
        settling.settling(m, series),
        settling.series_agrees(m, series),
        forces.weight_balance(some, usual),
        forces.constant_weight(some, usual),
        forces.drift(some, nominal, usual),
        stance_checks.plate_poses(m),
    ]
    if (single := m.support != "double").any():
        row = int(single.argmax())
        reason = f"{row_name(m, row)} stands on one foot ('{m.support[row]}'); this check needs both feet"
        findings += _skip((*LEGS, *FORCES), reason)
        return [*findings, identifiable(m, nominal_robot(nominal.robot, common_support(m.support)), None)]
    findings += [stance_checks.feet_on_plates(m, nominal), *stance_checks.legs(some, nominal, usual)]
    noise = reading_noise(some, nominal)
    if loads.result == "fail":
        findings += _fits(some, nominal, noise, None)
        findings += _skip(FORCES[1:], "correct the cells' loads first")
        return [*findings, identifiable(m, nominal, None)]
    findings += [stance_checks.load_in_soles(m, nominal), agreement.repeats(some, nominal, noise)]
    of_all = noise if some is m else reading_noise(m, nominal)
    return [*findings, *_fits(some, nominal, noise, usual), identifiable(m, nominal, of_all)]


def _independent(m: Measurements, nominal: Nominal) -> Measurements:
    """Return rows of a moving record whose noise is independent, without vertical inertial forces by CAD."""
    if m.joint_rates is None or m.joint_accelerations is None:
        return m
    observed = observe(m, nominal_robot(nominal.robot, common_support(m.support)))
    rows = apart(m.time, observed.segment, APART)
    force, lift = m.cell_forces.sum(axis=1, keepdims=True), observed.motion.by_cad[:, 2:3]
    share = np.divide(force - lift, force, out=np.ones_like(force), where=force > 0)
    return replace(m, cell_forces=m.cell_forces * share).take(rows)


def _of_wrenches(m: Measurements, some: Measurements, nominal: Nominal, usual: Usual) -> list[Finding]:
    reason = "needs the readings of vertical cells; there are wrench sensors"
    findings = [
        units.joint_limits(m, nominal),
        readings.stuck(m, nominal),
        *_skip(("cell loads", "stated noise"), reason),
        settling.steady_windows(m),
        *_skip(("settling", "series and table", "weight balance", "constant weight"), reason),
        forces.carried_weight(m, nominal),
        forces.horizontal_forces(m, nominal),
        forces.conventions(m, nominal),
        forces.drift(some, nominal, usual),
        *_skip(("plate poses", "feet on plates"), reason),
    ]
    if (m.support == "double").all():
        findings += stance_checks.legs(some, nominal, usual)
    else:
        findings += _skip(LEGS[1:], "some posture stands on one foot; this check needs both feet")
    findings += _skip(FORCES, reason)
    return [*findings, identifiable(m, nominal_robot(nominal.robot, common_support(m.support)), None)]


def _fits(m: Measurements, nominal: Nominal, noise: ReadingNoise, usual: Usual | None) -> list[Finding]:
    """Run the checks that need a fitted model; without usual changes that of the wiring alone."""
    names = FORCES[:1] if usual is None else (FORCES[0], *FORCES[3:])
    try:
        found = agreement.fit(m, regression(nominal.parameters, m, nominal.robot), noise)
    except InputError as problem:
        return _skip(names, str(problem))
    if found is None:
        return _skip(names, agreement.NO_CELL_SD)
    if usual is None:
        return [cell_wiring.wiring(m, found)]
    single = agreement.single_postures(m, found), agreement.single_placements(m, found)
    return [cell_wiring.wiring(m, found), *single, agreement.scatter(found, usual)]


def _skip(names: tuple[str, ...], reason: str) -> list[Finding]:
    return [skipped(name, reason) for name in names]
