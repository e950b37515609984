"""Compare the errors that each estimator reports with its real ones (docs/studies/coverage.md; minutes).

The shipped plan is held once in the full dynamics. Every run draws the sensors' averages and the recorded
plate poses again; the held postures stay. The default estimator has 1,000 runs, the others a quarter of that.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator

import numpy as np
from scipy.stats import t as t_distribution

from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.identification.estimators import ESTIMATORS, MIXED_MODEL, Estimate
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.regressor import regression
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import Measurements, SensorSheet
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import load_robot

SETTINGS = Settings(seed=105, only=("wii", "force-plate"))
RUNS = 1000
CHEAP = (
    "least-squares",
    "errors-in-variables",
    "robust",
)  # their clustered covariance differs from the other
FIRST_SEED = 1000  # runs for the table; thresholds were chosen on 0 to 99
DITHER_TERMS = 8
SHEETS: dict[str, Callable[[SensorSheet], SensorSheet]] = {
    "right": lambda sheet: sheet,
    "twice": lambda sheet: scaled(sheet, 2.0),
    "half": lambda sheet: scaled(sheet, 0.5),
    "none": lambda sheet: SensorSheet(),
}


def scaled(sheet: SensorSheet, factor: float) -> SensorSheet:
    """Return a data sheet with all s.d. wrong by a factor."""
    assert sheet.encoder_sd is not None
    assert sheet.cell_sd is not None
    assert sheet.placement_sd is not None
    x, y, yaw = sheet.placement_sd
    return dataclasses.replace(
        sheet,
        encoder_sd=factor * sheet.encoder_sd,
        cell_sd=factor * sheet.cell_sd,
        placement_sd=(factor * x, factor * y, factor * yaw),
    )


def averaged(
    truth: np.ndarray, repeat: float, noise: float, step: float, samples: int, rng: np.random.Generator
) -> np.ndarray:
    """Draw means of many rounded readings from their expectation and variance, same shape as `truth`.

    Noise dithers rounding: E[round(x + n)] = x + sum_k (-1)^k step / (pi k) exp(-2 (pi k noise / step)^2)
    sin(2 pi k x / step).
    """
    mean = truth + repeat * rng.standard_normal(truth.shape)
    if step > 0:
        if noise == 0:
            return np.round(mean / step) * step
        at = mean / step
        for k in range(1, DITHER_TERMS):
            weight = (-1) ** k * step / (np.pi * k) * np.exp(-2 * (np.pi * k * noise / step) ** 2)
            mean = mean + weight * np.sin(2 * np.pi * k * at)
    return mean + np.hypot(noise, step / np.sqrt(12)) / np.sqrt(samples) * rng.standard_normal(truth.shape)


def redrawn(rig: Rig, experiment: Outcome, rng: np.random.Generator) -> Measurements:
    """Read the held postures again, a hundred times faster than sample by sample."""
    m, s = experiment.measurements, rig.sensors
    samples = round(rig.protocol.window * s.sample_rate)
    angles = np.array([held.joint_angles for held in experiment.truth.held])
    forces = np.array([held.cell_forces for held in experiment.truth.held])
    return dataclasses.replace(
        m,
        sensors=header_of(rig).sensors,
        joint_angles=averaged(
            angles, s.encoder_repeatability, s.encoder_noise, s.encoder_resolution, samples, rng
        ),
        cell_forces=averaged(forces, s.cell_repeatability, s.cell_noise, s.cell_resolution, samples, rng),
        plate_poses=recorded_poses(rig, experiment, rng),
        weighed_mass=(experiment.truth.mass + s.weighed_mass_sd * rng.standard_normal(), s.weighed_mass_sd),
    )


def recorded_poses(rig: Rig, experiment: Outcome, rng: np.random.Generator) -> np.ndarray:
    """Draw the plate poses that are recorded when a placement is set up, for each measured row, (m, 2, 3)."""
    poses, error = [], np.array([rig.sensors.mark_sd, rig.sensors.placement_sd])
    recorded, before = np.zeros((2, 3)), None
    for attempt in experiment.truth.attempts:
        if before != attempt.placement:
            recorded, before = attempt.true_plates + error * rng.standard_normal((2, 3)), attempt.placement
        if attempt.held:
            poses.append(recorded)
    return np.array(poses)


@dataclasses.dataclass(frozen=True)
class Calibration:
    """The errors of one estimator over many runs, for each parameter, (p,) each.

    Attributes:
        bias: mean error over the true s.d. of the estimate.
        ratio: s.d. of the estimates over the root mean square of the reported standard errors.
        coverage: share of 95 % intervals that hold the truth.
        error: root mean square error [m].
        placed: the same ratio and coverage by the placement-clustered standard errors, (2, p).
    """

    bias: np.ndarray
    ratio: np.ndarray
    coverage: np.ndarray
    error: np.ndarray
    placed: np.ndarray


def calibration(estimates: list[Estimate], truth: np.ndarray) -> Calibration:
    errors = np.array([e.value for e in estimates]) - truth[estimates[0].numbers - 1]
    reported = np.array([standard_errors(e.covariance) for e in estimates])
    clustered = np.array([standard_errors(e.clustered_covariance) for e in estimates])
    half = np.array([t_distribution.ppf(0.975, e.interval_dof) for e in estimates])
    spread = errors.std(axis=0, ddof=1)
    ratio = [spread / np.sqrt((s**2).mean(axis=0)) for s in (reported, clustered)]
    cover = [(np.abs(errors) <= half * s).mean(axis=0) for s in (reported, clustered)]
    return Calibration(
        errors.mean(axis=0) / spread,
        ratio[0],
        cover[0],
        np.sqrt((errors**2).mean(axis=0)),
        np.array([ratio[1], cover[1]]),
    )


def run(
    rig: Rig, experiment: Outcome, nominal: Nominal, name: str, sheet: str, stream: list[int]
) -> tuple[Estimate, Estimate]:
    """Measure once and estimate the full and the simplified model."""
    measured = redrawn(rig, experiment, np.random.default_rng(stream))
    measured = dataclasses.replace(measured, sensors=SHEETS[sheet](measured.sensors))
    data = regression(nominal.parameters, measured, nominal.robot)
    estimator = ESTIMATORS[name].run
    return estimator(data), estimator(data.keep(nominal.robot.settings["simplified"]))


def span(values: np.ndarray, form: str) -> str:
    """Format the smallest and the largest value."""
    return f"{values.min():{form}} to {values.max():{form}}"


def figures(c: Calibration, clustered: bool) -> list[str]:
    """Return the cells of one line; the clustered standard errors are shown where they are others."""
    again = [span(c.placed[0], ".2f"), span(100 * c.placed[1], ".1f")] if clustered else ["same", "same"]
    return [
        *(span(c.bias, "+.2f"), span(c.ratio, ".2f"), span(100 * c.coverage, ".1f")),
        *(f"{100 * c.coverage.mean():.1f}", *again, f"{1e3 * np.median(c.error):.2f}"),
    ]


def study(settings: Settings) -> Iterator[str]:
    """Yield a line for each preset, data sheet or estimator, and model, then the CPU times."""
    robot = load_robot()
    nominal = nominal_robot(robot)
    experiment = run_dynamics(preset_rig("wii", robot), shipped_plan(robot), settings.seed, settings.workers)
    kinds = ("bias / s.d.", "s.d. / s.e.", "95 % coverage", "mean", "s.d. / clustered s.e.", "coverage by it")
    yield header("preset", "data sheet", "estimator", "model", "runs", *kinds, "median rms error, mm")
    runs = settings.count(RUNS)
    arms = [(MIXED_MODEL, sheet, runs) for sheet in SHEETS]
    arms += [(name, "right", max(1, runs // 4)) for name in ESTIMATORS if name != MIXED_MODEL]
    times = {}
    for preset in settings.only:
        rig = preset_rig(preset, robot)
        for name, sheet, count in arms:
            began, streams = time.process_time(), ([settings.seed, FIRST_SEED + k] for k in range(count))
            found = [run(rig, experiment, nominal, name, sheet, stream) for stream in streams]
            times[name] = 1e3 * (time.process_time() - began) / count
            for model, estimates in zip(("full", "simplified"), zip(*found, strict=True), strict=True):
                c = calibration(list(estimates), nominal.value)
                yield row(preset, sheet, name, model, count, *figures(c, name in CHEAP))
    spent = ", ".join(f"{name} {ms:.0f}" for name, ms in times.items())
    yield f"\nCPU time of a run, drawing and both models, ms: {spent}"
