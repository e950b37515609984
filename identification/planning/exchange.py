"""Exchange postures of a placement for random feasible ones, to leave local optima.

A plan has very many local optima, since each posture ends at a corner of the feasible set. As in Fedorov's
exchange algorithm (1972), postures are exchanged for candidates if that reduces the objective.
"""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.planning.blocks import SCALE, Block
from tulip_testbed.identification.planning.constraints import evaluate
from tulip_testbed.identification.planning.footing import PLAN, footing
from tulip_testbed.identification.planning.objectives import Smooth
from tulip_testbed.identification.planning.problem import PlanningProblem

DRAWS = 1000  # about one in a hundred is feasible
PASSES = 3  # over a placement's postures


def candidates(problem: PlanningProblem, swing: np.ndarray, start: Block, rng: np.random.Generator) -> Block:
    """Draw feasible random postures on a placement, between none and some tens.

    Args:
        swing: pose of the swing foot, (3,) [m, m, rad].
        start: postures that give initial joint angles and the range of heights.
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
    return Block(design[feasible], evaluation.chain.angles[feasible])


def exchange(
    problem: PlanningProblem, start: Block, pool: Block, rest: np.ndarray, smooth: Smooth, wanted: int
) -> Block:
    """Choose the `wanted` postures of start and pool that minimise a function of M, one exchange at a time.

    Args:
        start: initial postures; if fewer than `wanted`, the best of the pool are added first.
        rest: information of the other placements, (p, p).
    """
    design = np.concatenate([start.design, pool.design])
    angles = np.concatenate([start.angles, pool.angles])
    rows = problem.parameters.regressor(angles)
    each = rows.mT @ rows
    chosen = list(range(len(start.design)))
    total = rest + each[chosen].sum(axis=0)

    def best(base: np.ndarray) -> tuple[float, int]:
        free = [k for k in range(len(design)) if k not in chosen]
        values = [smooth(base + each[k])[0] for k in free]
        at = int(np.argmin(values))
        return values[at], free[at]

    while len(chosen) < wanted:
        _, k = best(total)
        chosen.append(k)
        total = total + each[k]
    for _ in range(PASSES):
        before = list(chosen)
        for place, old in enumerate(before):
            if len(chosen) == len(design):
                break
            base = total - each[old]
            value, new = best(base)
            if value < smooth(total)[0]:
                chosen[place] = new
                total = base + each[new]
        if chosen == before:
            break
    return Block(design[chosen], angles[chosen])
