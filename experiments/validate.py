"""The main job: identify the robot of a simulated run, compare with the truth, give a verdict."""

import dataclasses
import time
from contextlib import suppress

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments import checks
from tulip_testbed.experiments.checks import Check
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.run_file import configuration_of, made_by
from tulip_testbed.experiments.simulate import SimulatedTruth
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.identification.base_parameters import BaseParameters, renumbered
from tulip_testbed.identification.estimators import solve_least_squares
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.identification.statistics import correlations
from tulip_testbed.sim.outcome import Truth
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.sensors import Sensors

LEAST_SQUARES = "least-squares"  # the paper's estimator
NEGLIGIBLE = 1e-6  # m: a parameter that the simplified model may drop without bias


def judge(run: Run, estimator: str = DEFAULT_ESTIMATOR, scale: float = 0.0) -> Validation:
    """Identify the robot from a run and hold the estimates against its truth.

    The scale is that of the imperfections that were drawn for the run's laboratory.
    """
    began, laboratory, robot = time.perf_counter(), run.laboratory, run.laboratory.robot
    truth = laboratory.true_base_parameters(run.plan)
    identification = identify(run.measurements, robot, estimator=estimator, adopted=laboratory.known)
    plain = None
    with suppress(InputError):  # it knows of no unknown zeros of wrench sensors, or masses on the robot
        plain = identify(run.measurements, robot, estimator=LEAST_SQUARES, adopted=laboratory.known)
    configuration = configuration_of(laboratory, run.plan, run.seed, run.engine, scale)
    return Validation(
        identification=identification,
        least_squares=plain,
        truth=truth,
        checks=tuple(evaluate(run, identification, truth)),
        wall_s=time.perf_counter() - began,
        imperfections=float(scale),
        robot=robot,
        plan=run.plan,
        measurements=run.measurements,
        simulation=SimulatedTruth.of(run),
        document=made_by("validate", configuration, robot),
    )


def evaluate(run: Run, identification: Identification, truth: np.ndarray) -> list[Check]:
    full, simplified = identification.full, identification.simplified
    robot = run.laboratory.robot
    settings = robot.settings
    pairs = [renumbered(robot, identification.parameters, e["pair"]) for e in settings.get("correlated", [])]
    # With noise-free sensors the statistical checks have nothing to measure errors by.
    noisy = dataclasses.replace(run.laboratory.rig.sensors, cell_gain={}) != Sensors()
    found = []
    described = [("full model", full), ("simplified model", simplified)]
    for name, estimate in described if "simplified" in settings else described[:1]:
        kept = truth[estimate.numbers - 1]
        lost = np.delete(truth, estimate.numbers - 1)
        if len(lost) and np.abs(lost).max() > NEGLIGIBLE:
            found.append(checks.skipped(f"{name}: all errors", "the true robot is outside this model"))
        elif noisy:
            found.append(checks.joint_check(f"{name}: all errors", estimate, kept))
            found.append(checks.largest_z_check(f"{name}: largest |z|", estimate, kept))
        else:
            found.append(checks.ideal_error_check(f"{name}: largest error (mm)", estimate, kept, pairs))
    if not noisy:
        found.append(
            checks.skipped("joint chi-square and |z|", "noise-free data have no standard errors to test")
        )
    taken = run.measurements
    measured = correlations_at(identification.parameters, taken.joint_angles, taken.support)
    planned = planned_correlations(run, identification.parameters)
    found += checks.correlation_checks(measured, planned, pairs)
    if identification.calibration is not None and noisy:
        data = correlations(identification.calibration.data_covariance)
        found += checks.data_correlation_checks(data, planned, pairs)
    placements = len(np.unique(run.measurements.placement))
    known = settings.get("residual_sigma_mm", {})
    found.append(checks.sigma_check(run.laboratory.sensors, full.sigma, placements, known))
    paper = settings.get("paper", {})
    usable = 1 - len(run.truth.dropped) / run.plan.postures
    if paper:
        rate = paper["postures_used"] / paper["postures_planned"]
        source = f"the paper: {paper['postures_used']} of {paper['postures_planned']}"
        found.append(checks.below("share of dropped postures", 1 - usable, 1 - rate, source))
    found.append(checks.mass_check(*identification.mass, run.truth.mass, len(run.measurements), noisy))
    return [*found, *balance_checks(run)]


def balance_checks(run: Run) -> list[Check]:
    """Check that every hold is in balance; empty in statics."""
    laboratory = run.laboratory
    effects = laboratory.known or laboratory.hidden or laboratory.rig.edit is not None
    return held_balance(run.truth, laboratory.rig, whole=not effects)


def held_balance(truth: Truth, rig: Rig, whole: bool) -> list[Check]:
    """Check that every hold is in balance; empty without holds or rest; whole: see `balance_check`."""
    worst = checks.worst_balance(truth)
    if worst is None or not np.isfinite(rig.protocol.speed_gate):
        return []
    weight = float(truth.mass * -rig.robot.model.opt.gravity[2])
    return [checks.balance_check(worst, weight, whole)]


def planned_correlations(run: Run, parameters: BaseParameters) -> np.ndarray:
    """Compute the correlations (eq. 15) that the planned angles of the measured postures predict, (p, p).

    Those of a motion are the commanded angles of its rows.
    """
    m = run.measurements
    if run.plan.motion is not None:
        assert m.command is not None
        return correlations_at(parameters, m.command, m.support)
    row = {int(number): k for k, number in enumerate(run.plan.posture)}
    rows = [row[int(number)] for number in m.posture]
    return correlations_at(parameters, run.plan.joint_angles[rows], run.plan.support[rows])


def correlations_at(parameters: BaseParameters, joint_angles: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Compute eq. 15 by the regressor of these angles, for any estimator, (p, p)."""
    matrix = stacked_regressor(parameters, joint_angles, support)
    return correlations(solve_least_squares(matrix, np.zeros(len(matrix)))[1])
