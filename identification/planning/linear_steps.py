"""Sequential linear programming on the whole plan, in which all placements move at once.

Most variables of an optimal plan end at a constraint. Steps to the corners of the linearised constraints
(Fletcher and Sainz de la Maza 1989), inside a trust region, therefore converge quickly. The programs are
sparse, since a posture depends on its own and its swing foot's variables only; scipy's HiGHS solves them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import scipy

from tulip_testbed.identification.planning.blocks import FEASIBLE, SCALE, information, information_slope
from tulip_testbed.identification.planning.constraints import Evaluated, Evaluation, evaluate
from tulip_testbed.identification.planning.objectives import Smooth
from tulip_testbed.identification.planning.problem import PlanningProblem

REGION = 0.3  # trust region at first, relative to the variables' scales
GROW, SHRINK = 1.5, 0.4
WIDEST, NARROWEST = 1.0, 1e-3  # trust regions
REPAIR, STRICT = 20, 10.0  # linear steps that restore feasibility, and the weight of violations in them
MOST_LACK = 0.2  # largest violation of an inequality by linearisation


E = TypeVar("E", bound=Evaluated)


@dataclass(frozen=True)
class Steps(Generic[E]):
    """How the postures of a plan move.

    Attributes:
        per: number of postures that move together, as those of one placement.
        columns: which of all variables are each posture's, (m, v); postures may share some.
        scale: of the variables, (v,).
        slope: derivatives of a function of M by each posture's variables, (m, v), from df/dM, (p, p).
        interval: smallest and largest step of each scaled variable, (m, v) each.
        moved: evaluate the postures after a step, (m, v).
    """

    per: int
    columns: np.ndarray
    scale: np.ndarray | float
    slope: Callable[[E, np.ndarray], np.ndarray]
    interval: Callable[[E], tuple[np.ndarray, np.ndarray]]
    moved: Callable[[E, np.ndarray], E]


def merit(plan: Evaluated, smooth: Smooth, penalty: float) -> float:
    """Return the objective plus the penalty for violated constraints."""
    lack = np.maximum(-plan.inequalities.min(axis=1), 0.0)
    return smooth(information(plan))[0] + penalty * float(lack.sum())


def descend(
    steps: Steps[E], plan: E, smooth: Smooth, iterations: int, penalty: float, region: float = REGION
) -> E:
    """Take linear steps of all placements while they reduce the merit; they may end slightly infeasible.

    A placement whose step violates a constraint by nonlinearity stays unchanged and gets a smaller trust
    region than the first, so that one straight knee does not slow down all placements.
    """
    per = steps.per
    value, regions = merit(plan, smooth, penalty), np.full(len(plan.inequalities) // per, region)
    for _ in range(iterations):
        cost = steps.slope(plan, smooth(information(plan))[1])
        program = plan, cost, steps.columns, steps.interval(plan)
        step, gain = elastic_step(*program, np.repeat(regions, per), penalty, steps.scale)
        if gain < 1e-6:
            break
        for _ in range(2):
            moved = steps.moved(plan, step)
            lack, before = (np.maximum(-w.inequalities.min(axis=1), 0.0) for w in (moved, plan))
            broken = (lack > before + MOST_LACK).reshape(-1, per).any(axis=1)
            if not broken.any():
                break
            regions = np.where(broken, SHRINK * regions, regions)
            step = step * np.repeat(~broken, per)[:, None]
        after = merit(moved, smooth, penalty)
        if after >= value:  # correct for the curvature of the constraints
            rates = (plan.inequality_jacobian @ step[..., None])[..., 0]
            missed = moved.inequalities - plan.inequalities - rates
            step, _ = elastic_step(*program, np.repeat(regions, per), penalty, steps.scale, missed)
            moved = steps.moved(plan, step)
            after = merit(moved, smooth, penalty)
        if after < value:
            plan, value = moved, after
            regions = np.where(broken, regions, np.minimum(GROW * regions, WIDEST))
        else:
            regions = SHRINK * regions
        if regions.max() < NARROWEST:
            break
    return plan


def repaired(steps: Steps[E], plan: E, smooth: Smooth | None = None) -> E:
    """Return a feasible plan near this one that keeps a function of M small, or one that is less infeasible.

    Steps that also improve the plan always leave some violation; small ones without an objective leave none.
    """
    if plan.inequalities.min() >= -FEASIBLE:
        return plan
    plan = descend(steps, plan, smooth or _anywhere, REPAIR, STRICT)
    return descend(steps, plan, _anywhere, REPAIR, STRICT, NARROWEST)


def _anywhere(information: np.ndarray) -> tuple[float, np.ndarray]:
    return 0.0, np.zeros_like(information)


def on_both_feet(problem: PlanningProblem, count: int, per: int) -> Steps[Evaluation]:
    """Return how the postures of placements of `per` postures move by their design variables u."""
    intervals = np.concatenate([problem.ranges.torso, problem.ranges.swing])

    def interval(plan: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        low = np.full((count, len(SCALE)), -np.inf)
        high = -low
        low[:, 3:], high[:, 3:] = (intervals.T[:, None] - plan.design[:, 3:]) / SCALE[3:]
        return low, high

    def moved(plan: Evaluation, step: np.ndarray) -> Evaluation:
        change = np.clip((plan.joint_jacobian @ step[..., None])[..., 0], -0.5, 0.5)
        return evaluate(problem, plan.design + step, plan.chain.joint_angles + change)

    return Steps(per, variables(count, per), SCALE, information_slope, interval, moved)


def variables(count: int, per: int) -> np.ndarray:
    """Return which of a plan's variables are each posture's nine, (m, 9).

    Every posture has six of its own; the three of a swing foot are those of all postures of its placement.
    """
    posture = np.arange(count)[:, None]
    shared = 6 * count + posture // per * 3 + np.arange(3)
    return np.concatenate([6 * posture + np.arange(6), shared], axis=1)


def elastic_step(
    plan: Evaluated,
    cost: np.ndarray,
    columns: np.ndarray,
    interval: tuple[np.ndarray, np.ndarray],
    region: np.ndarray,
    penalty: float,
    scale: np.ndarray | float,
    missed: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, float]:
    """Minimise a linear function of scaled variables in a trust region, with penalties for violations.

    Args:
        plan: postures at the start, with their inequalities, (m, s).
        cost: derivatives of the objective by each posture's variables, (m, v).
        columns: which of all variables these are, (m, v); postures may share some.
        interval: smallest and largest step of each scaled variable, (m, v) each.
        region: trust region of each posture, (m,).
        penalty: weight of the largest violation of each posture.
        scale: of the variables, (v,).
        missed: error of the linearised inequalities after a first step, (m, s) (second-order correction,
            Fletcher 1982).

    Returns:
        The step, (m, v), and the predicted reduction of the objective with its penalties; no step and 0 if
        the program fails.
    """
    inequalities, slopes = plan.inequalities, plan.inequality_jacobian * scale
    (count, width), size = columns.shape, int(columns.max()) + 1
    objective = np.zeros(size + count)
    np.add.at(objective, columns, cost * scale)
    objective[size:] = penalty  # of each posture's elastic variable
    reachable = inequalities < region[:, None] * np.abs(slopes).sum(axis=2) + 1e-3
    row, column = np.nonzero(reachable)
    rows = np.arange(len(row))
    matrix = scipy.sparse.coo_array(
        (
            np.concatenate([-slopes[row, column].ravel(), -np.ones(len(row))]),
            (
                np.concatenate([np.repeat(rows, width), rows]),
                np.concatenate([columns[row].ravel(), size + row]),
            ),
        ),
        shape=(len(row), size + count),
    )
    low, high = interval
    low, high = np.clip(low, -region[:, None], 0.0), np.clip(high, 0.0, region[:, None])
    bounds = np.zeros((size + count, 2))
    bounds[columns, 0], bounds[columns, 1] = low, high
    bounds[size:, 1] = np.inf
    result = scipy.optimize.linprog(
        objective, A_ub=matrix, b_ub=(inequalities + missed)[row, column], bounds=bounds, method="highs"
    )
    if result.x is None:
        return np.zeros(columns.shape), 0.0
    lack = np.maximum(-inequalities.min(axis=1), 0.0)
    return result.x[columns] * scale, float(penalty * lack.sum() - result.fun)
