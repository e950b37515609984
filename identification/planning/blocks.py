"""Postures of one placement, and their exchange for others.

A plan has very many local optima, since each posture ends at a corner of the feasible set. As in Fedorov's
exchange algorithm (1972), postures are exchanged for candidates if that reduces the objective.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.planning.constraints import Evaluated, Evaluation, evaluate
from tulip_testbed.identification.planning.footing import PLAN, footing
from tulip_testbed.identification.planning.objectives import Smooth
from tulip_testbed.identification.planning.problem import PlanningProblem

SCALE = np.array([0.05, 0.05, 0.05, 0.3, 0.3, 0.3, 0.05, 0.05, 0.3])  # of the design variables [m, rad]
SHARED = slice(6, 9)
# Violation of an inequality that linear steps may leave; `Margins.rounding` is a hundred times as large.
FEASIBLE = 1e-7
DRAWS = 1000  # about one in a hundred is feasible
PASSES = 3  # over a placement's postures


@dataclass(frozen=True)
class Block:
    """Postures of one placement.

    Attributes:
        design: design variables, (k, 9) [m, rad, m, m, rad]; the columns of the swing foot are constant.
        angles: joint angles, (k, n) [rad].
    """

    design: np.ndarray
    angles: np.ndarray


def information(evaluation: Evaluated) -> np.ndarray:
    """Compute the information matrix M = H'H of the postures, (p, p)."""
    rows = evaluation.regressor.reshape(-1, evaluation.regressor.shape[-1])
    return rows.T @ rows


def information_slope(evaluation: Evaluation, by_matrix: np.ndarray) -> np.ndarray:
    """Differentiate a function of M by the design variables, (k, 9), from its derivative df/dM, (p, p)."""
    by_regressor = 2 * evaluation.regressor @ by_matrix
    return np.einsum("mip,mipu->mu", by_regressor, evaluation.regressor_slopes, optimize=True)


def candidates(problem: PlanningProblem, swing: np.ndarray, start: Block, rng: np.random.Generator) -> Block:
    """Draw feasible random postures on a placement with a swing foot's pose, between none and some tens.

    The postures `start` give initial joint angles and the range of heights.
    """
    r = problem.ranges
    design = np.empty((DRAWS, 9))
    corners = np.concatenate([problem.soles[0], problem.soles[1] + swing[:2]])
    design[:, :2] = rng.uniform(corners.min(axis=0), corners.max(axis=0), (DRAWS, 2))
    heights = start.design[:, 2]
    design[:, 2] = rng.uniform(heights.min() - 0.1, heights.max() + 0.1, DRAWS)
    low, high = r.torso.T
    design[:, 3:6] = rng.uniform(low, high, (DRAWS, 3))
    design[:, 6:] = swing
    plan = np.zeros((DRAWS, PLAN))  # with an exact CoM; its uncertainty is included in `evaluate` below
    plan[:, :5] = design[:, [0, 1, 6, 7, 8]]
    foot = footing(problem, plan)
    feasible = (foot.polygon.min(axis=1) >= r.stability_margin) & (foot.boards.min(axis=1) >= 0)
    feasible &= (foot.soles.min(axis=1) >= r.sole_margin) & (foot.cells.min(axis=1) >= r.least_cell_load)
    feasible &= foot.feet.min(axis=1) >= problem.margins.foot_load
    design = design[feasible]
    if not len(design):
        return Block(design, np.zeros((0, start.angles.shape[1])))
    distance = np.abs((design[:, None, :6] - start.design[None, :, :6]) / SCALE[:6]).sum(axis=2)
    evaluation = evaluate(problem, design, start.angles[distance.argmin(axis=1)])
    feasible = evaluation.reached & (evaluation.inequalities.min(axis=1) >= 0)
    return Block(design[feasible], evaluation.chain.joint_angles[feasible])


def exchange(
    problem: PlanningProblem, start: Block, pool: Block, rest: np.ndarray, smooth: Smooth, wanted: int
) -> Block:
    """Choose the `wanted` postures of start and pool that minimise a function of M, one exchange at a time.

    If there are fewer at the start, the best of the pool are added first. The rest is the information of the
    other placements, (p, p).
    """
    design = np.concatenate([start.design, pool.design])
    angles = np.concatenate([start.angles, pool.angles])
    rows = problem.parameters.regressor(angles)
    each = rows.mT @ rows
    chosen = list(range(len(start.design)))
    total = rest + each[chosen].sum(axis=0)

    while len(chosen) < wanted:
        free = [k for k in range(len(design)) if k not in chosen]
        chosen.append(min(free, key=lambda k: smooth(total + each[k])[0]))
        total = total + each[chosen[-1]]
    (chosen,) = exchanged([each], [chosen], total, smooth)
    return Block(design[chosen], angles[chosen])


def exchanged(
    pools: Sequence[np.ndarray], first: Sequence[list[int]], total: np.ndarray, smooth: Smooth
) -> list[list[int]]:
    """Exchange chosen postures for others of their pool, one at a time, while a function of M decreases.

    The pools hold the information of each posture, (k, p, p), of which the rows `first` are chosen at first.
    The total, (p, p), is that of these and of all other postures.
    """
    chosen, value = [list(rows) for rows in first], smooth(total)[0]
    for _ in range(PASSES):
        before = value
        for each, rows in zip(pools, chosen, strict=True):
            for place in range(len(rows)):
                free = [k for k in range(len(each)) if k not in rows]
                base = total - each[rows[place]]
                values = [smooth(base + each[k])[0] for k in free]
                if values and min(values) < value:
                    rows[place] = free[int(np.argmin(values))]
                    total, value = base + each[rows[place]], min(values)
        if value == before:
            break
    return chosen
