"""Estimate the base parameters in many simulated experiments, after a few placements and after many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from studies.runner import rows_of, shipped_plan
from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.estimators import estimate_by
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.regressor import regression
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

PRESET, SEED = "wii", 31


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Estimates from many experiments.

    Attributes:
        names: of the parameters, (p,). truth: their true values, (p,) [mm].
        values: estimates, (runs, p) [mm]. covariance: stated, mean of the runs, (p, p) [mm2].
    """

    names: tuple[str, ...]
    truth: np.ndarray
    values: np.ndarray
    covariance: np.ndarray

    def of(self, numbers: tuple[int, int]) -> Ensemble:
        """Return the ensemble of two parameters by their numbers, from 1."""
        k = np.array(numbers) - 1
        names = (self.names[k[0]], self.names[k[1]])
        return Ensemble(names, self.truth[k], self.values[:, k], self.covariance[np.ix_(k, k)])


def ensembles(runs: int, placements: tuple[int, ...]) -> dict[int, Ensemble]:
    """Simulate experiments with the shipped plan by statics and estimate from their first placements.

    Returns:
        the estimates by the number of placements.
    """
    robot = load_robot()
    plan, parameters = shipped_plan(robot, max(placements)), base_parameters(robot)
    streams = np.random.SeedSequence(SEED).spawn(runs)
    outcomes = run_statics(solve_plan(preset_rig(PRESET, robot), plan), streams)
    truth = 1e3 * nominal_robot(robot).value
    found = {}
    for count in placements:
        estimates = [
            estimate_by(
                regression(parameters, rows_of(o.measurements, o.measurements.placement <= count), robot)
            )
            for o in outcomes
        ]
        values = 1e3 * np.array([one.value for one in estimates])
        covariance = 1e6 * np.mean([one.covariance for one in estimates], axis=0)
        found[count] = Ensemble(parameters.names, truth, values, covariance)
    return found


def ellipse(center: np.ndarray, covariance: np.ndarray, level: float = 0.95, points: int = 181) -> np.ndarray:
    """Return the contour that holds a normal distribution in the plane with a probability, (points, 2).

    Args:
        center: (2,). covariance: (2, 2).
    """
    around = np.linspace(0, 2 * np.pi, points)
    circle = np.column_stack([np.cos(around), np.sin(around)])
    return center + np.sqrt(chi2.ppf(level, 2)) * circle @ np.linalg.cholesky(covariance).T


def share_inside(
    values: np.ndarray, center: np.ndarray, covariance: np.ndarray, level: float = 0.95
) -> float:
    """Return which share of estimates, (runs, 2), lies inside of the contour of `ellipse`."""
    away = values - center
    distance = np.einsum("ri,ij,rj->r", away, np.linalg.inv(covariance), away)
    return float(np.mean(distance < chi2.ppf(level, 2)))
