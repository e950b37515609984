"""The main job: simulate, identify, compare with the truth, give a verdict."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.removal import without
from tulip_testbed.experiments.checks import (
    Check,
    below,
    correlation_checks,
    ideal_error_check,
    joint_check,
    largest_z_check,
    mass_check,
    sigma_check,
    skipped,
    verdict,
)
from tulip_testbed.experiments.scenario import Scenario
from tulip_testbed.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    common_support,
    renumbered,
    simplified_numbers,
)
from tulip_testbed.identification.center_of_pressure import total_mass
from tulip_testbed.identification.estimators import (
    DEFAULT,
    Estimate,
    StandardEstimate,
    estimate_by,
    solve_least_squares,
)
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.regressor import check_robot, regression, stacked_regressor
from tulip_testbed.identification.statistics import (
    correlations,
    high_correlations,
    relative_standard_errors,
    residual_norms,
    standard_errors,
)
from tulip_testbed.sim.dynamics.dynamic_run import Experiment, run_experiment
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.sensors import Sensors

HIGH_CORRELATION = 0.85  # the paper's level
NEGLIGIBLE = 1e-6  # m: a parameter that the simplified model may drop without bias


@dataclass(frozen=True)
class Identification:
    """Both models' estimates from one set of measurements."""

    parameters: BaseParameters
    full: Estimate
    simplified: Estimate
    mass: tuple[float, float]
    estimator: str = DEFAULT


@dataclass(frozen=True)
class Validation:
    """A validation with all that its report needs; `truth` is (p,) [m]."""

    scenario: Scenario
    experiment: Experiment
    identification: Identification
    truth: np.ndarray
    checks: tuple[Check, ...]
    wall_s: float

    @property
    def verdict(self) -> str:
        return verdict(list(self.checks))


def identify(
    measurements: Measurements,
    robot: Robot,
    source: str = "measurements",
    estimator: str = DEFAULT,
    parameters: BaseParameters | None = None,
    adopted: Sequence[EffectInstance] = (),
) -> Identification:
    """Full and simplified model.

    Args:
        estimator: a name of `identification.estimators.ESTIMATORS`.
        parameters: the robot's base parameters, if they are at hand: for many identifications of one robot.
        adopted: effects that the measurements are freed of before the regression.

    Raises:
        InputError: the measurements do not fit the robot or do not suffice, or an unknown estimator.
    """
    parameters = parameters or base_parameters(
        robot, support=common_support(measurements.support, f"{source}: postures")
    )
    if adopted:
        check_robot(parameters, measurements, robot, source)
        measurements, observed = without(measurements, nominal_robot(robot, parameters.support), adopted)
        parameters = dataclasses.replace(parameters, tree=observed.tree)
    data = regression(parameters, measurements, robot, source)
    kept = simplified_numbers(robot, parameters)
    full = estimate_by(data, estimator)
    simplified = full if len(kept) == len(data.numbers) else estimate_by(data.keep(kept), estimator)
    return Identification(parameters, full, simplified, total_mass(measurements), estimator)


def validate(
    scenario: Scenario,
    workers: int = 1,
    progress: Callable[[int], None] = lambda count: None,
    estimator: str = DEFAULT,
) -> Validation:
    """Run a scenario and hold the estimates against its truth.

    Raises:
        InputError: nothing could be measured, or too little to identify.
    """
    began = time.perf_counter()
    experiment = run_experiment(scenario.rig, scenario.plan, scenario.seed, workers, progress)
    found = identify(
        experiment.measurements, scenario.rig.robot, estimator=estimator, adopted=scenario.adopted
    )
    truth = scenario.true_base_parameters()
    checks = evaluate(scenario, experiment, found, truth)
    return Validation(scenario, experiment, found, truth, tuple(checks), time.perf_counter() - began)


def evaluate(
    scenario: Scenario, experiment: Experiment, found: Identification, truth: np.ndarray
) -> list[Check]:
    """The checks of the verdict."""
    full, simplified = found.full, found.simplified
    settings = scenario.rig.robot.settings
    robot = scenario.rig.robot
    pairs = [renumbered(robot, found.parameters, e["pair"]) for e in settings.get("correlated", [])]
    # With noise-free sensors the statistical checks have nothing to measure errors by.
    noisy = dataclasses.replace(scenario.rig.sensors, cell_gain={}) != Sensors()
    checks = []
    described = [("full model", full), ("simplified model", simplified)]
    for name, estimate in described if "simplified" in settings else described[:1]:
        kept = truth[estimate.numbers - 1]
        lost = np.delete(truth, estimate.numbers - 1)
        if len(lost) and np.abs(lost).max() > NEGLIGIBLE:
            checks.append(skipped(f"{name}: all errors", "the true robot is outside this model"))
        elif noisy:
            checks.append(joint_check(f"{name}: all errors", estimate, kept))
            checks.append(largest_z_check(f"{name}: largest |z|", estimate, kept))
        else:
            checks.append(ideal_error_check(f"{name}: largest error (mm)", estimate, kept, pairs))
    if not noisy:
        checks.append(skipped("joint chi-square and |z|", "noise-free data have no standard errors to test"))
    measured = correlations_at(found.parameters, experiment.measurements.joint_angles)
    planned = planned_correlations(scenario, experiment, found.parameters)
    checks += correlation_checks(full.numbers, measured, planned, pairs)
    placements = len(np.unique(experiment.measurements.placement))
    checks.append(sigma_check(scenario.preset, full.sigma, placements, settings.get("residual_sigma_mm", {})))
    paper = settings.get("paper", {})
    usable = 1 - len(experiment.dropped) / scenario.plan.postures
    if paper:
        rate = paper["postures_used"] / paper["postures_planned"]
        source = f"the paper: {paper['postures_used']} of {paper['postures_planned']}"
        checks.append(below("share of dropped postures", 1 - usable, 1 - rate, source))
    checks.append(mass_check(*found.mass, experiment.true_mass, len(experiment.measurements), noisy))
    return checks


def planned_correlations(
    scenario: Scenario, experiment: Experiment, parameters: BaseParameters
) -> np.ndarray:
    """Correlations (eq. 15) that the planned angles of the measured postures predict, (p, p)."""
    row = {int(number): k for k, number in enumerate(scenario.plan.posture)}
    rows = [row[int(number)] for number in experiment.measurements.posture]
    return correlations_at(parameters, scenario.plan.joint_angles[rows])


def correlations_at(parameters: BaseParameters, joint_angles: np.ndarray) -> np.ndarray:
    """Eq. 15 by the regressor of these angles, (p, p); whatever the estimator."""
    matrix = stacked_regressor(parameters, joint_angles)
    return correlations(solve_least_squares(matrix, np.zeros(len(matrix)))[1])


def model_document(estimate: Estimate, truth: np.ndarray | None) -> dict[str, Any]:
    """One model's part of the JSON report [m, kg; keys that end in _mm in mm]."""
    error = standard_errors(estimate.covariance)
    clustered = standard_errors(estimate.clustered_covariance)
    relative = relative_standard_errors(estimate.value, error)
    norms = residual_norms(estimate.residual)
    rows = []
    for k, number in enumerate(estimate.numbers.tolist()):
        rows.append(
            {
                "number": number,
                "name": estimate.names[k],
                "truth": None if truth is None else float(truth[number - 1]),
                "estimate": float(estimate.value[k]),
                "standard_error": float(error[k]),
                "clustered_standard_error": float(clustered[k]),
                "relative_standard_error": float(relative[k]),
            }
        )
    pairs = high_correlations(estimate.covariance, estimate.numbers, HIGH_CORRELATION)
    standard = estimate.standard
    return {
        "parameters": rows,
        **({} if standard is None else {"links": link_rows(standard), "visible_masses": standard.visible}),
        "sigma_mm": 1e3 * estimate.sigma,
        "placement_sd_mm": [1e3 * sd for sd in estimate.placement_sd],
        "condition_number": estimate.condition_number,
        "residual_mm": {"mean": 1e3 * norms.mean, "sd": 1e3 * norms.sd, "max": 1e3 * norms.max},
        "correlations": [{"a": a, "b": b, "rho": rho} for a, b, rho in pairs],
    }


def link_rows(standard: StandardEstimate) -> list[dict[str, Any]]:
    """Masses and centres of mass of a JSON report [kg, m; keys that end in _share: 0 to 1]."""
    return [
        {
            "link": link,
            "mass": float(standard.mass[k]),
            "mass_standard_error": float(standard.mass_error[k]),
            "mass_data_share": float(standard.mass_share[k]),
            "center": standard.center[k].tolist(),
            "center_standard_error": standard.center_error[k].tolist(),
            "center_data_share": standard.center_share[k].tolist(),
        }
        for k, link in enumerate(standard.links)
    ]


def worst_books(experiment: Experiment) -> dict[str, float]:
    """The worst of every balance that the laboratory keeps, over all held postures."""
    books = [dataclasses.asdict(held.books) for held in experiment.held]
    worst = {
        name: max(abs(b[name]) for b in books)
        for name in ("weight", "moments", "torques", "centre", "kinetic")
    }
    return worst | {"least_dissipated": min(b["dissipated"] for b in books)}


def report_document(result: Validation) -> dict[str, Any]:
    """The JSON report of a validation."""
    found, experiment = result.identification, result.experiment
    return {
        "verdict": result.verdict,
        "estimator": found.estimator,
        "checks": [dataclasses.asdict(check) for check in result.checks],
        "postures_planned": result.scenario.plan.postures,
        "postures_used": result.scenario.plan.postures - len(experiment.dropped),
        "rows_measured": len(experiment.measurements),
        "dropped": [{"posture": posture, "reason": reason} for posture, reason in experiment.dropped],
        "condition_number": found.full.condition_number,
        "total_mass": {
            "truth": experiment.true_mass,
            "estimate": found.mass[0],
            "standard_error": found.mass[1],
        },
        "full": model_document(found.full, result.truth),
        "simplified": model_document(found.simplified, result.truth),
        "books": worst_books(experiment),
        "wall_s": result.wall_s,
    }
