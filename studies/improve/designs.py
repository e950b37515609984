"""Plans of different condition number, chosen from a pool of random placements, and criteria to rank them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from studies.runner import part_of
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.sim.measurements import PosturePlan

Criterion = Callable[[np.ndarray], float]


def condition_number(matrix: np.ndarray) -> float:
    """Of H, the paper's objective (eq. 9)."""
    return float(np.linalg.cond(matrix))


def scaled_condition_number(matrix: np.ndarray) -> float:
    """Of H with columns of unit length: at most sqrt(p) times any scaling's least (van der Sluis 1969)."""
    return float(np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0)))


def mean_standard_error(matrix: np.ndarray) -> float:
    """Root of trace((H'H)^-1) / p: RMS standard error for independent errors of unit s.d. (A-optimality)."""
    return float(np.sqrt((np.linalg.svd(matrix, compute_uv=False) ** -2.0).mean()))


CRITERIA: dict[str, Criterion] = {
    "condition_number": condition_number,
    "scaled_condition_number": scaled_condition_number,
    "mean_se": mean_standard_error,
}


def placement_blocks(parameters: BaseParameters, pool: PosturePlan) -> np.ndarray:
    """Regressor of each placement, (placements, 2 postures, p); all with as many postures."""
    matrix = stacked_regressor(parameters, pool.joint_angles)
    count = len(np.unique(pool.placement))
    return matrix.reshape(count, -1, matrix.shape[1])


def random_choices(blocks: np.ndarray, placements: int, tries: int, rng: np.random.Generator) -> np.ndarray:
    """Random placements, sorted by the condition number of their regressor, (tries, placements)."""
    drawn = np.array([rng.choice(len(blocks), placements, replace=False) for _ in range(tries)])
    return drawn[np.argsort([condition_number(joined(blocks, chosen)) for chosen in drawn])]


def joined(blocks: np.ndarray, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
    """Stacked regressor of some placements, (rows, p)."""
    return blocks[np.asarray(chosen)].reshape(-1, blocks.shape[2])


def exchanged(
    blocks: np.ndarray,
    start: np.ndarray,
    criterion: Criterion,
    trials: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Placements after random exchanges, each kept if it lowers the criterion (Fedorov 1972)."""
    chosen, best = start.copy(), criterion(joined(blocks, start))
    for _ in range(trials):
        trial = chosen.copy()
        trial[rng.integers(len(trial))] = rng.integers(len(blocks))
        if len(set(trial)) == len(trial) and (value := criterion(joined(blocks, trial))) < best:
            chosen, best = trial, value
    return chosen


def plan_of(pool: PosturePlan, chosen: np.ndarray) -> PosturePlan:
    """The plan of some placements, by their index."""
    return part_of(pool, np.isin(pool.placement, np.unique(pool.placement)[chosen]))
