"""A plan before any data: what it would show without noise, and how well it would identify the robot.

To first order an estimate by generalised least squares moves by (H'V^-1 H)^-1 H'V^-1 d, d being what the
effect adds to the residuals of the centre of pressure. An effect that changes the robot itself (a payload, a
wrong length) moves, besides, what is estimated. Both together are the bias against the nominal robot.
"""

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import at_least
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.columns import effect_columns, presence_column
from tulip_testbed.discovery.nominal_laboratory import without_noise
from tulip_testbed.effects.true_robot import true_base_parameters, true_model
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.estimators import MIXED_MODEL, estimate_by
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.regressor import regression
from tulip_testbed.identification.residual_channels import ROWS, SIZE
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
        observed: what sensors without noise would show, with the preset's data sheets.
        noise: as those sheets state.
        standard_errors: of the base parameters by the default estimator, root mean square over the
            runs, (p,) [m].
        seed: of the runs. sensors: name of the preset.
    """

    rig: Rig
    plan: PosturePlan
    observed: Observation
    noise: Noise
    standard_errors: np.ndarray
    seed: int
    sensors: str

    @property
    def nominal(self) -> Nominal:
        return self.observed.nominal


def planned(plan: PosturePlan, sensors: str, robot: Robot, seed: int) -> Planned:
    """Simulate a plan by static equilibrium, with a seed of the noisy runs."""
    at_least("seed", seed, 0)
    rig, nominal = preset_rig(sensors, robot), nominal_robot(robot, common_support(plan.support))
    quiet = without_noise(rig)
    (tried,) = run_statics(solve_plan(quiet, plan), np.random.SeedSequence(seed).spawn(1))
    stands = plan.take(np.isin(plan.posture, tried.measurements.posture))
    (smooth,) = noisy(solve_plan(quiet, stands), seed, 1)
    weighed = smooth.weighed_mass
    smooth = replace(
        smooth,
        sensors=header_of(rig).sensors,
        weighed_mass=weighed and (weighed[0], rig.sensors.weighed_mass_sd),
    )
    observed = observe(smooth, nominal)
    variance = [
        np.diag(estimate_by(regression(nominal.parameters, run, robot, "plan"), MIXED_MODEL).covariance)
        for run in noisy(solve_plan(rig, stands), seed, RUNS)
    ]
    errors = np.sqrt(np.mean(variance, axis=0))
    return Planned(rig, plan, observed, noise_of(observed), errors, seed, sensors)


def noisy(solved_plan: SolvedPlan, seed: int, count: int) -> list[Measurements]:
    """Return the measurements of some runs, with every posture that has an equilibrium."""
    streams = np.random.SeedSequence(seed).spawn(count)
    return [run.measurements for run in run_statics(solved_plan, streams, all_solved=True)]


class BiasWeights:
    """The default estimator about a planned experiment, with the noise that the data sheets state.

    Attributes:
        linear: of channel A alone. regressor: whitened, (r, p).
    """

    def __init__(self, planned: Planned):
        self.linear = linear_model(planned.observed, planned.noise, "A")
        regressor = planned.nominal.parameters.regressor(self.linear.smoothed.joint_angles)
        rows = np.zeros((len(planned.observed), SIZE, regressor.shape[2]))
        rows[:, ROWS["A"]] = regressor
        self.regressor = self.linear.whitening(rows)

    def change(self, candidate: Candidate, point: int) -> np.ndarray:
        """Of the estimate by an effect, (p, s) [m per unit of each size]; one without size: (p, 1) [m]."""
        if candidate.effect.sizes:
            added = effect_columns(self.linear, candidate, point)
        else:
            # The planned readings are free of it; taking it away from them brings it in.
            added = -presence_column(self.linear, candidate, point)
        return np.linalg.lstsq(self.regressor, added, rcond=None)[0]


def own_change(planned: Planned, candidate: Candidate, point: int) -> np.ndarray:
    """Of the robot's own base parameters by an effect that is on or in it, (p, s) [m].

    The sizes take their priors' s.d. one after the other: a payload's place counts once it has a mass.
    """
    count, prior = max(len(candidate.effect.sizes), 1), candidate.prior
    out = np.zeros((len(planned.standard_errors), count))
    changed = _with(planned.rig, candidate, prior, point)
    if changed.edit is planned.rig.edit:
        return out
    after, before = true_model(changed), true_model(planned.rig)
    # An edit may as well concern the world or the soles.
    own = ("body_mass", "body_ipos", "body_pos", "jnt_pos")
    if all(np.array_equal(getattr(after, name), getattr(before, name)) for name in own):
        return out
    value = planned.nominal.value
    for k in range(len(candidate.effect.sizes)):
        changed = _with(planned.rig, candidate, prior * (np.arange(count) <= k), point)
        moved = true_base_parameters(changed, planned.nominal.parameters.support)
        out[:, k], value = moved - value, moved
    return out


def bias(planned: Planned, estimator: BiasWeights, candidate: Candidate, point: int) -> np.ndarray:
    """Against the nominal robot, at one prior s.d. of each size, (p, s) [m]; without size: (p, 1)."""
    unit = candidate.prior if candidate.effect.sizes else np.ones(1)
    return estimator.change(candidate, point) * unit + own_change(planned, candidate, point)


def _with(rig: Rig, candidate: Candidate, sizes: np.ndarray, point: int) -> Rig:
    return candidate.effect.inject(rig, candidate.target, candidate.values(sizes, point))
