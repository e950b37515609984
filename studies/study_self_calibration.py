"""Coverage and error of the self-calibrating estimate (docs/studies/calibration.md; half an hour).

A laboratory has a random robot and, if it is ordinary, members of all families with spreads of 0.1 to 1
tolerance, injected into the static laboratory. In a null nothing but the robot's masses differs. The oracle
knows the spreads and the scales of the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.families import families_of, tolerances_of
from tulip_testbed.calibration.ordinary_laboratory import draw_members
from tulip_testbed.calibration.reml import given
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.effects.injection import edited
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.identification.estimators import DEFAULT, Estimate
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.variance_components import MARK_RATIO
from tulip_testbed.measurements import SensorSheet
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.sensors import PRESETS

SETTINGS = Settings(seed=1, only=("wii", "force-plate"))
LABORATORIES = 100
ROBOTS = (0.05, 0.2)  # of random robots
LEAST_DATA = 0.5  # share of a direction's variance that is not from members known by their prior alone
BOOTSTRAPS = 1000
TINY = 1e-12  # an interval that begins at zero holds zero


@dataclass(frozen=True)
class Score:
    """The accuracy of an estimate of one laboratory.

    Attributes:
        determined, prior_only: whether each interval of a member holds the truth.
        base: whether each interval of a base parameter does, (p,).
        z: error over s.e. in the directions that the data determine.
        oracle: the same errors, and s.e., over the oracle's s.e. of those directions, (2, k).
        oracle_z: the oracle's errors over its s.e.
        mixed: error over s.e. of `mixed-model` in its own principal directions, (p,).
        mixed_base: whether its intervals of base parameters hold the truth, (p,).
        against_mixed: s.e. over that of `mixed-model` by parameter, (p,).
        z_of_members: (value - truth) / s.e. of every number.
        names: of the numbers' families. spreads: true and estimated, (f, 2).
    """

    determined: np.ndarray
    prior_only: np.ndarray
    base: np.ndarray
    z: np.ndarray
    oracle: np.ndarray
    oracle_z: np.ndarray
    mixed: np.ndarray
    mixed_base: np.ndarray
    against_mixed: np.ndarray
    z_of_members: np.ndarray
    names: tuple[str, ...]
    spreads: np.ndarray


def study(settings: Settings) -> Iterator[str]:
    """Yield one table a preset."""
    for preset in settings.only:
        for ordinary in (True, False):
            numbers = range(settings.seed, settings.seed + settings.count(LABORATORIES if ordinary else 40))
            kind = "ordinary" if ordinary else "nulls"
            calls = [(preset, seed, ordinary) for seed in numbers]
            scores = settings.parallel(f"{preset}, {kind}", score, calls)
            yield f"\n**{preset}, {kind}**, {len(scores)} laboratories\n"
            yield from table(scores)


def table(scores: list[Score]) -> Iterator[str]:
    """Yield the figures with bootstrap intervals over the laboratories."""
    yield header("figure", "value", "95 % interval")
    figures = {
        "determined members: coverage": [s.determined for s in scores],
        "members known by their prior only: coverage": [s.prior_only for s in scores],
        "base parameters: coverage": [s.base for s in scores],
        "base parameters, mixed-model: coverage": [s.mixed_base for s in scores],
    }
    for name, parts in figures.items():
        yield row(name, *_text(parts, np.mean))
    sizes = {
        "r.m.s. error in s.e., determined directions": [s.z for s in scores],
        "the same of the oracle": [s.oracle_z for s in scores],
        "r.m.s. error in s.e., mixed-model": [s.mixed for s in scores],
        "r.m.s. error over the oracle's": [s.oracle for s in scores],
    }
    for name, parts in sizes.items():
        if name.endswith("oracle's"):
            ratio = [(p[0], p[2]) for p in parts]
            error = np.sqrt(sum((a**2).sum() for a, _ in ratio) / sum((b**2).sum() for _, b in ratio))
            yield row(name, f"{error:.3f}", "")
            every = np.concatenate([p[1] for p in parts])
            yield row(
                "s.e. over the oracle's (median, 95 %)",
                f"{np.median(every):.3f}",
                f"{np.quantile(every, 0.95):.3f}",
            )
        else:
            yield row(name, *_text(parts, lambda x: float(np.sqrt((x**2).mean()))))
    every = np.concatenate([s.against_mixed for s in scores])
    yield row("s.e. over mixed-model's (median)", f"{np.median(every):.3f}", "")
    names = np.concatenate([s.names for s in scores])
    z = np.concatenate([s.z_of_members for s in scores])
    yield ""
    yield header("family", "r.m.s. z", "coverage by 1.96 s.e.", "mean z", "mean ln(spread / true)")
    families = dict.fromkeys(names.tolist())
    for k, name in enumerate(families):
        of = z[names == name]
        ratio = [np.log(s.spreads[k, 1] / s.spreads[k, 0]) for s in scores if s.spreads[k, 0] > 0]
        spread = f"{np.mean(ratio):.2f}" if ratio else ""
        yield row(
            name,
            f"{np.sqrt((of**2).mean()):.2f}",
            f"{np.mean(np.abs(of) < 1.96):.3f}",
            f"{of.mean():.2f}",
            spread,
        )


def _text(parts: list[np.ndarray], figure: Callable[[np.ndarray], float]) -> tuple[str, str]:
    """Return a figure over all laboratories and its bootstrap interval."""
    parts = [p for p in parts if len(p)]
    if not parts:
        return "none", ""
    rng = np.random.default_rng(0)
    draws = [
        figure(np.concatenate([parts[i] for i in rng.integers(len(parts), size=len(parts))]))
        for _ in range(BOOTSTRAPS)
    ]
    low, high = np.quantile(draws, [0.025, 0.975])
    return f"{figure(np.concatenate(parts)):.3f}", f"{low:.3f} to {high:.3f}"


@one_blas_thread
def score(preset: str, seed: int, ordinary: bool) -> Score:
    """Simulate one laboratory and hold the estimates against its truth."""
    rng = np.random.default_rng((seed, 77))
    robot = load_robot()
    plan = shipped_plan(robot)
    spread = float(rng.uniform(*ROBOTS))
    rig = edited(preset_rig(preset, robot), edit_of(robot.model, draw_robot(robot.model, spread, rng)))
    sensors = PRESETS[preset]
    sheet = SensorSheet(cell_sd=sensors.cell_repeatability, placement_sd=sensors.placement_sd)
    families = families_of(robot, tolerances_of(sheet))
    values, spreads = draw_members(families, rng)
    if not ordinary:
        values, spreads = [0 * v for v in values], 0 * spreads
    hidden = [i for f, v in zip(families, values, strict=True) for i in f.instances(v)] if ordinary else []
    laboratory = Laboratory(robot, preset, hidden=tuple(hidden), nominal=rig)
    measurements = laboratory.run(plan, seed, "statics").measurements
    truth = laboratory.true_base_parameters(plan)
    found = self_calibrate(observe(measurements, nominal_robot(robot)))
    mixed = identify(measurements, robot, estimator=DEFAULT).full
    return _score(found, values, spreads, truth, mixed, preset)


def _score(
    found: SelfCalibration,
    values: list[np.ndarray],
    spreads: np.ndarray,
    truth: np.ndarray,
    mixed: Estimate,
    preset: str,
) -> Score:
    p = len(truth)
    members, true = found.families, np.concatenate(values)
    interval = np.concatenate([m.interval95 for m in members])
    inside = (interval[:, 0] <= true + TINY) & (true - TINY <= interval[:, 1])
    known = np.concatenate([m.determined for m in members])
    value = np.concatenate([m.value for m in members])
    sd = np.concatenate([m.standard_error for m in members])
    error = found.theta - truth
    ways = determined_directions(found)
    sensors = PRESETS[preset]
    mark = sensors.mark_sd[0] / (MARK_RATIO * sensors.placement_sd[0])
    per_part = np.repeat(spreads, [len(m.family.parts) for m in members])
    scales = np.array([1.0, 1.0, mark, 1.0, 1.0])
    oracle = given(found.problem, scales, np.maximum(per_part, 1e-3))
    se, oracle_se = _errors(ways, found.covariance), _errors(ways, oracle.covariance[:p, :p])
    oracle_error = ways.T @ (oracle.estimate[:p] - truth)
    variance, turn = np.linalg.eigh(mixed.covariance)
    mixed_se = np.sqrt(np.diag(mixed.covariance))
    return Score(
        determined=inside[known],
        prior_only=inside[~known],
        base=_covered(error, np.sqrt(np.diag(found.covariance)), found.interval_dof),
        z=ways.T @ error / se,
        oracle=np.array([ways.T @ error / oracle_se, se / oracle_se, oracle_error / oracle_se]),
        oracle_z=oracle_error / oracle_se,
        mixed=turn.T @ (mixed.value - truth) / np.sqrt(variance),
        mixed_base=_covered(mixed.value - truth, mixed_se, mixed.interval_dof),
        against_mixed=np.sqrt(np.diag(found.covariance)) / mixed_se,
        z_of_members=(value - true) / sd,
        names=tuple(m.family.name for m in members for _ in range(len(m.value))),
        spreads=np.column_stack([spreads, [m.spread for m in members]]),
    )


def determined_directions(found: SelfCalibration) -> np.ndarray:
    """Return directions of the base parameters with independent errors that the data determine, (p, k).

    Of the variance in such a direction, less than half is due to members that only their prior knows.
    """
    share, ways = map(np.asarray, eigh(found.prior_covariance, found.covariance))
    return ways[:, share < LEAST_DATA]


def _errors(ways: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("pk,pq,qk->k", ways, covariance, ways))


def _covered(error: np.ndarray, se: np.ndarray, dof: np.ndarray) -> np.ndarray:
    return np.abs(error) <= t_ppf(0.975, dof) * se
