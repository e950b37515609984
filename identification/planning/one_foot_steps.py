"""Improve postures on one foot by sequential linear programming; every posture stays feasible.

Joint angles are the variables, since the chain is open. The constraints of a posture involve its own angles
only, so that one that comes to violate them is put back alone and gets a smaller trust region.
"""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.planning.blocks import FEASIBLE
from tulip_testbed.identification.planning.linear_steps import elastic_step
from tulip_testbed.identification.planning.objectives import Smooth
from tulip_testbed.identification.planning.one_foot import OneFoot, evaluate_one_foot
from tulip_testbed.identification.planning.problem import Problem

REGION, WIDEST, NARROWEST = 0.2, 0.5, 2e-3  # trust regions [rad]
GROW, SHRINK = 1.5, 0.4
CORRECTIONS = 3  # of a step for the curvature of the constraints
GAIN = 1e-6  # smallest predicted gain of a step


def information_on_one_foot(found: OneFoot) -> np.ndarray:
    """Compute the information matrix M = H'H of the postures, (p, p)."""
    rows = found.regressor.reshape(-1, found.regressor.shape[-1])
    return rows.T @ rows


def descend_on_one_foot(
    problem: Problem, angles: np.ndarray, swing: np.ndarray, smooth: Smooth, iterations: int
) -> np.ndarray:
    """Minimise a function of the postures' information from feasible postures.

    Args:
        problem: the robot and its constraints.
        angles: joint angles of feasible postures, (m, n) [rad].
        swing: pose of the standing swing foot, under which its board lies, (3,) [m, m, rad].
        smooth: function of M and its gradient.
        iterations: largest number of steps.

    Returns:
        Joint angles of feasible postures with a smaller value, or the same, (m, n) [rad].
    """
    standing = np.broadcast_to(swing, (len(angles), 3))
    found, region = evaluate_one_foot(problem, angles, standing), np.full(len(angles), REGION)
    value, by_matrix = smooth(information_on_one_foot(found))
    for _ in range(iterations):
        cost = np.einsum("mip,minp->mn", found.regressor @ by_matrix, found.regressor_slopes, optimize=True)
        moved, gain = _moved(problem, found, standing, 2 * cost, region)
        if gain < GAIN or region.max() < NARROWEST:
            break
        broken = moved.inequalities.min(axis=1) < -FEASIBLE
        region = np.where(broken, SHRINK * region, region)
        kept = np.where(broken[:, None], found.chain.angles, moved.chain.angles)
        moved = evaluate_one_foot(problem, kept, standing)
        after, slope = smooth(information_on_one_foot(moved))
        if after < value:
            found, value, by_matrix = moved, after, slope
            region = np.where(broken, region, np.minimum(GROW * region, WIDEST))
        else:
            region = SHRINK * region
    return found.chain.angles


def _moved(
    problem: Problem, found: OneFoot, standing: np.ndarray, cost: np.ndarray, region: np.ndarray
) -> tuple[OneFoot, float]:
    """Return the postures after a linear step, corrected for curvature, and the gain that it predicts."""
    angles = found.chain.angles
    columns = np.arange(angles.size).reshape(angles.shape)
    free = np.full(angles.shape, np.inf)
    now, slopes = found.inequalities, found.inequality_jacobian
    room, moved, gain = now, found, 0.0
    for count in range(1 + CORRECTIONS):
        step, predicted = elastic_step(cost, columns, angles.size, now, slopes, (-free, free), region, room)
        gain = predicted if count == 0 else gain
        moved = evaluate_one_foot(problem, angles + step, standing)
        if moved.inequalities.min() >= -FEASIBLE:
            break
        missed = moved.inequalities - now - (slopes @ step[..., None])[..., 0]
        room = now + np.minimum(missed, 0.0)
    return moved, gain
