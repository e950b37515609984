"""A plan before any data: what it would show without noise, and how well it would identify the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import at_least
from tulip_testbed.discovery.refit import without_noise
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.estimators import MIXED_MODEL, estimate_by
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.regressor import regression
from tulip_testbed.identification.residual_noise import Noise, noise_of
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.statics.solved_plan import SolvedPlan, solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

RUNS = 20  # over which the estimator's variances are averaged


@dataclass(frozen=True)
class Planned:
    """A plan in the nominal laboratory of a sensor preset.

    Attributes:
        rig: that laboratory. plan: all postures.
        solved_plan: those that the nominal robot can be measured in, solved.
        observed: what sensors without noise would show, with the preset's data sheets.
        noise: as those sheets state.
        runs: noisy runs, every posture that has an equilibrium, the same rows in each.
        standard_errors: of the base parameters by the default estimator, root mean square over the
            runs, (p,) [m].
        seed: of the runs. sensors: name of the preset.
    """

    rig: Rig
    plan: PosturePlan
    solved_plan: SolvedPlan
    observed: Observation
    noise: Noise
    runs: tuple[Measurements, ...]
    standard_errors: np.ndarray
    seed: int
    sensors: str

    @property
    def nominal(self) -> Nominal:
        return self.observed.nominal


def planned(plan: PosturePlan, sensors: str, robot: Robot, seed: int) -> Planned:
    """Simulate a plan by static equilibrium.

    Args:
        seed: of the noisy runs.
    """
    at_least("seed", seed, 0)
    rig, nominal = preset_rig(sensors, robot), nominal_robot(robot, common_support(plan.support))
    quiet = without_noise(rig)
    stands = usable(plan, run_statics(solve_plan(quiet, plan), streams(seed, 1))[0].measurements.posture)
    (smooth,) = noisy(solve_plan(quiet, stands), streams(seed, 1))
    weighed = smooth.weighed_mass
    smooth = replace(
        smooth,
        sensors=header_of(rig).sensors,
        weighed_mass=weighed and (weighed[0], rig.sensors.weighed_mass_sd),
    )
    observed = observe(smooth, nominal)
    solved_plan = solve_plan(rig, stands)
    runs = noisy(solved_plan, streams(seed, RUNS))
    variance = [
        np.diag(estimate_by(regression(nominal.parameters, run, robot, "plan"), MIXED_MODEL).covariance)
        for run in runs
    ]
    errors = np.sqrt(np.mean(variance, axis=0))
    return Planned(rig, plan, solved_plan, observed, noise_of(observed), tuple(runs), errors, seed, sensors)


def usable(plan: PosturePlan, postures: np.ndarray) -> PosturePlan:
    """Return the rows of a plan that have these numbers."""
    return plan.take(np.isin(plan.posture, postures))


def streams(seed: int, count: int) -> list[np.random.SeedSequence]:
    """Random streams of the first runs of a seed."""
    return np.random.SeedSequence(seed).spawn(count)


def noisy(solved_plan: SolvedPlan, of: Sequence[np.random.SeedSequence]) -> list[Measurements]:
    """Return the measurements of some runs, with every posture that has an equilibrium."""
    return [run.measurements for run in run_statics(solved_plan, of, all_solved=True)]


def estimates(runs: Sequence[Measurements], nominal: Nominal) -> np.ndarray:
    """Return the base parameters of every run by the default estimator, (runs, p) [m]."""
    return np.array(
        [
            estimate_by(regression(nominal.parameters, run, nominal.robot, "plan"), MIXED_MODEL).value
            for run in runs
        ]
    )
