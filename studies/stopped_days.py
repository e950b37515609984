"""Days that end as soon as the standard errors are small enough: do the intervals still hold the truth?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.experiments.watching.day_model import DayModel, day_model
from tulip_testbed.experiments.watching.design_information import (
    no_information,
    placement_begun,
    with_posture,
)
from tulip_testbed.experiments.watching.row_columns import row_columns
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.identification.estimators import DEFAULT, estimate_by
from tulip_testbed.identification.estimators.estimate import Estimate
from tulip_testbed.identification.regressor import regression
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.random_robots import draw_robot
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

SPREAD = 0.1  # of the robots
AT_ONCE = 20  # days
ABOUT = 80  # rows: the target is what a first day promises there
FIRST, EVERY = 50, 10  # rows at which the rule by the residuals is looked at
RULES = ("whole day", "by the data sheets", "by the residuals")


@dataclass(frozen=True)
class Stopped:
    """One day that ended by a rule: rows, share of the intervals that hold, error over standard error."""

    rule: str
    rows: int
    covered: float
    ratio: float


@one_blas_thread
def stopped_days(robot: Robot, plan: PosturePlan, preset: str, seed: int, count: int) -> Iterator[Stopped]:
    """Simulate days by statics, every one with a random robot, and end each by every rule."""
    solved = solve_plan(preset_rig(preset, robot), plan)
    streams = np.random.SeedSequence([seed, len(preset)]).spawn(count + 1)
    rng = np.random.default_rng(streams[-1])
    target, done = None, 0
    while done < count:
        size = min(AT_ONCE, count - done)
        standard = np.array([draw_robot(robot.model, SPREAD, rng) for _ in range(size)])
        for k, outcome in enumerate(run_statics(solved, streams[done : done + size], standard)):
            rows = outcome.measurements
            model = day_model(plan, robot, rows)
            promised = promises(model, rows)
            if target is None:
                target = promised[ABOUT].max()
            truth = model.nominal.parameters.values(standard[k])
            yield from _by_rules(model, rows, promised, float(target), truth)
        done += size


def _by_rules(
    model: DayModel, rows: Measurements, promised: np.ndarray, target: float, truth: np.ndarray
) -> Iterator[Stopped]:
    m = len(rows)
    met = np.flatnonzero(promised.max(axis=1) <= target)
    ends = {RULES[0]: m, RULES[1]: int(met[0]) + 1 if len(met) else m}
    for rule, end in ends.items():
        yield _judged(rule, estimated(model, rows, end), end, truth)
    end = FIRST
    found = None
    while found is None or (end < m and np.sqrt(np.diag(found.covariance)).max() > target):
        end = min(end + EVERY, m) if found is not None else FIRST
        found = estimated(model, rows, end)
    yield _judged(RULES[2], found, end, truth)


def promises(model: DayModel, rows: Measurements) -> np.ndarray:
    """Return the standard errors that `tulip watch` tells after every row, (m, p) [m]."""
    columns, information, out = row_columns(model, rows), no_information(model.parameters), []
    for k in range(len(rows)):
        if k == 0 or rows.placement[k] != rows.placement[k - 1]:
            information = placement_begun(information)
        information = with_posture(information, model, columns.row(k))
        out.append(information.standard_errors())
    return np.array(out)


def estimated(model: DayModel, rows: Measurements, end: int) -> Estimate | None:
    """Estimate the base parameters from the first rows by default; None: they do not suffice."""
    try:
        first = rows.take(np.arange(end))
        return estimate_by(regression(model.nominal.parameters, first, model.nominal.robot, "day"), DEFAULT)
    except InputError:
        return None


def _judged(rule: str, found: Estimate | None, end: int, truth: np.ndarray) -> Stopped:
    if found is None:
        return Stopped(rule, end, np.nan, np.nan)
    error = np.sqrt(np.diag(found.covariance))
    half = t_ppf(0.975, found.interval_dof) * error
    off = np.abs(found.value - truth)
    return Stopped(rule, end, float((off <= half).mean()), float(np.sqrt(((off / error) ** 2).mean())))
