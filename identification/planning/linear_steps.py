"""Sequential linear programming on the whole plan: all placements move at once.

Most of an optimal plan's variables end at some constraint, so steps to the corners of the linearised
constraints (Fletcher and Sainz de la Maza 1989), inside a trust region, come near quickly. The
programs are sparse, since a posture touches its own and its swing foot's variables alone; scipy's
HiGHS solves them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array

from tulip_testbed.identification.planning.blocks import SCALE, information, information_slope
from tulip_testbed.identification.planning.constraints import Evaluation, evaluate
from tulip_testbed.identification.planning.objectives import Smooth
from tulip_testbed.identification.planning.problem import Problem

PENALTY = 0.1  # of a posture's worst slot below zero, against the objective
GROW, SHRINK = 1.5, 0.4
WIDEST, NARROWEST = 1.0, 1e-3  # regions, of the variables' scales
MOST_LACK = 0.2  # of a slot: what linearising may have missed


@dataclass(frozen=True)
class EvaluatedPlan:
    """A plan's postures, placement by placement.

    Attributes:
        design: (m, 9) [m, rad, m, m, rad]. found: evaluated there.
        per: postures a placement.
    """

    design: np.ndarray
    found: Evaluation
    per: int


def evaluate_plan(problem: Problem, design: np.ndarray, angles: np.ndarray, per: int) -> EvaluatedPlan:
    return EvaluatedPlan(design, evaluate(problem, design, angles), per)


def merit(plan: EvaluatedPlan, smooth: Smooth) -> float:
    lack = np.maximum(-plan.found.inequalities.min(axis=1), 0.0)
    return smooth(information(plan.found))[0] + PENALTY * float(lack.sum())


def descend(
    problem: Problem, plan: EvaluatedPlan, smooth: Smooth, iterations: int, regions: np.ndarray
) -> tuple[EvaluatedPlan, np.ndarray]:
    """Steps while they help; postures may end slightly infeasible.

    A placement whose step broke a constraint that was linear in prediction stays where it was, with a
    smaller region of its own: one stretched knee must not hold up the rest.

    Args:
        regions: of trust by placement, over the variables' scales, (k,) [-].

    Returns:
        The plan, and the regions to go on with.
    """
    value = merit(plan, smooth)
    for _ in range(iterations):
        step, gain = linear_step(problem, plan, smooth, np.repeat(regions, plan.per))
        if gain < 1e-6:
            break
        for _ in range(2):
            moved = _moved(problem, plan, step)
            lack, before = (np.maximum(-w.found.inequalities.min(axis=1), 0.0) for w in (moved, plan))
            broken = (lack > before + MOST_LACK).reshape(-1, plan.per).any(axis=1)
            if not broken.any():
                break
            regions = np.where(broken, SHRINK * regions, regions)
            step = step * np.repeat(~broken, plan.per)[:, None]
        after = merit(moved, smooth)
        if after >= value:  # curved constraints: once more with what linearising has missed
            missed = moved.found.inequalities - plan.found.inequalities - _rates(plan, step)
            step, _ = linear_step(problem, plan, smooth, np.repeat(regions, plan.per), missed)
            moved = _moved(problem, plan, step)
            after = merit(moved, smooth)
        if after < value:
            plan, value = moved, after
            regions = np.where(broken, regions, np.minimum(GROW * regions, WIDEST))
        else:
            regions = SHRINK * regions
        if regions.max() < NARROWEST:
            break
    return plan, regions


def _moved(problem: Problem, plan: EvaluatedPlan, step: np.ndarray) -> EvaluatedPlan:
    change = np.clip((plan.found.joint_jacobian @ step[..., None])[..., 0], -0.5, 0.5)
    return evaluate_plan(problem, plan.design + step, plan.found.chain.angles + change, plan.per)


def _rates(plan: EvaluatedPlan, step: np.ndarray) -> np.ndarray:
    return (plan.found.inequality_jacobian @ step[..., None])[..., 0]


def linear_step(
    problem: Problem,
    plan: EvaluatedPlan,
    smooth: Smooth,
    region: np.ndarray,
    missed: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """The linear program's step (m, 9) and what it promises of the merit.

    Args:
        missed: by how much the slots lie beyond their linearisation after a first step, (m, s); None: 0
            (second-order correction, Fletcher 1982).
    """
    count, per, found = len(plan.design), plan.per, plan.found
    places = count // per
    _, by_matrix = smooth(information(found))
    cost = information_slope(found, by_matrix) * SCALE
    own = np.arange(count)[:, None] * 6 + np.arange(6)
    shared = 6 * count + (np.arange(count) // per)[:, None] * 3 + np.arange(3)
    columns = np.concatenate([own, shared], axis=1)  # (m, 9)
    size = 6 * count + 3 * places
    objective = np.zeros(size + count)
    np.add.at(objective, columns, cost)
    objective[size:] = PENALTY  # of each posture's elastic variable

    slopes = found.inequality_jacobian * SCALE
    near = found.inequalities < region[:, None] * np.abs(slopes).sum(axis=2) + 1e-3
    row, slot = np.nonzero(near)
    rows = np.arange(len(row))
    matrix = coo_array(
        (
            np.concatenate([-slopes[row, slot].ravel(), -np.ones(len(row))]),
            (
                np.concatenate([np.repeat(rows, 9), rows]),
                np.concatenate([columns[row].ravel(), size + row]),
            ),
        ),
        shape=(len(row), size + count),
    )
    r = problem.ranges
    low, high = np.full((2, count, 9), -np.inf)
    high = -high
    intervals = np.array([r.torso_roll, r.torso_pitch, r.torso_yaw, r.swing_x, r.swing_y, r.swing_yaw])
    low[:, 3:], high[:, 3:] = (intervals.T[:, None] - plan.design[:, 3:]) / SCALE[3:]
    low, high = np.clip(low, -region[:, None], 0.0), np.clip(high, 0.0, region[:, None])
    bounds = np.zeros((size + count, 2))
    bounds[columns, 0], bounds[columns, 1] = low, high
    bounds[size:, 1] = np.inf
    room = found.inequalities if missed is None else found.inequalities + missed
    result = linprog(objective, A_ub=matrix, b_ub=room[row, slot], bounds=bounds, method="highs")
    if result.x is None:
        return np.zeros_like(plan.design), 0.0
    lack = np.maximum(-found.inequalities.min(axis=1), 0.0)
    return result.x[columns] * SCALE, float(PENALTY * lack.sum() - result.fun)
