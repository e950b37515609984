"""One placement's postures at a time: scipy's SLSQP on the variables that share a swing foot.

The plan's information is the sum of its placements', and a placement's constraints touch its own
variables alone. So each block is a small dense problem: 3 + 6 variables a posture, the rest of the
plan's information held fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from tulip_testbed.identification.planning.constraints import Evaluation, evaluate
from tulip_testbed.identification.planning.objectives import Smooth
from tulip_testbed.identification.planning.problem import Problem

SCALE = np.array([0.05, 0.05, 0.05, 0.3, 0.3, 0.3, 0.05, 0.05, 0.3])  # of the design variables [m, rad]
OWN, SHARED = slice(0, 6), slice(6, 9)
FREEDOM = 0.5  # of the scale: how far one block's step may go, so that inverse kinematics follows
FARTHEST = 0.5  # rad: of a prediction by dq/du
FEASIBLE = 1e-7  # of a slot: what SLSQP may leave; `Margins.rounding` is a hundred times as much


@dataclass(frozen=True)
class Block:
    """A placement's postures.

    Attributes:
        design: (k, 9) [m, rad, m, m, rad]; the swing foot's columns are all the same.
        angles: (k, n) [rad].
    """

    design: np.ndarray
    angles: np.ndarray


def pack(design: np.ndarray) -> np.ndarray:
    """Swing foot, then every posture's own six, each over its scale, (3 + 6 k,)."""
    scaled = design / SCALE
    return np.concatenate([scaled[0, SHARED], scaled[:, OWN].ravel()])


def unpack(x: np.ndarray) -> np.ndarray:
    """(k, 9)"""
    own = x[3:].reshape(-1, 6)
    return np.column_stack([own, np.broadcast_to(x[:3], (len(own), 3))]) * SCALE


def gradient_of_block(slopes: np.ndarray) -> np.ndarray:
    """From derivatives by each posture's nine variables (k, s, 9) to (k s, 3 + 6 k), scaled."""
    count, slots, _ = slopes.shape
    scaled = slopes * SCALE
    whole = np.zeros((count, slots, 3 + 6 * count))
    whole[:, :, :3] = scaled[:, :, SHARED]
    for k in range(count):
        whole[k, :, 3 + 6 * k : 9 + 6 * k] = scaled[k, :, OWN]
    return whole.reshape(count * slots, -1)


def bounds(problem: Problem, postures: int) -> np.ndarray:
    """Of the packed variables, (3 + 6 k, 2)."""
    r, free = problem.ranges, (-np.inf, np.inf)
    own = np.array([free, free, free, r.torso_roll, r.torso_pitch, r.torso_yaw])
    swing = np.array([r.swing_x, r.swing_y, r.swing_yaw])
    return np.vstack([swing / SCALE[SHARED, None], np.tile(own / SCALE[OWN, None], (postures, 1))])


def information(evaluation: Evaluation) -> np.ndarray:
    """M = H'H of the postures, (p, p)."""
    rows = evaluation.regressor.reshape(-1, evaluation.regressor.shape[-1])
    return rows.T @ rows


def information_slope(evaluation: Evaluation, by_matrix: np.ndarray) -> np.ndarray:
    """Derivative of a function of M by the design variables, (k, 9); `by_matrix`: df/dM, (p, p)."""
    by_regressor = 2 * evaluation.regressor @ by_matrix
    return np.einsum("mip,mipu->mu", by_regressor, evaluation.regressor_slopes, optimize=True)


def improve(problem: Problem, block: Block, rest: np.ndarray, smooth: Smooth, iterations: int) -> Block:
    """Minimise a function of M over one block.

    Args:
        block: feasible.
        rest: information of the other placements, (p, p).

    Returns:
        A block that keeps every constraint and has a smaller value, or the same block.
    """

    def objective(found: Evaluation) -> tuple[float, np.ndarray]:
        value, by_matrix = smooth(rest + information(found))
        return value, information_slope(found, by_matrix)

    return _minimise(problem, block, objective, iterations)


def repair(problem: Problem, block: Block, iterations: int = 60) -> Block:
    """The nearest block that keeps every constraint; whatever SLSQP ends with where it finds none."""
    x0 = pack(block.design)

    def distance(x: np.ndarray, _: Evaluation) -> tuple[float, np.ndarray]:
        return float(((x - x0) ** 2).sum()) / 2, x - x0

    return _slsqp(problem, block, distance, iterations, freedom=4 * FREEDOM)


def _minimise(
    problem: Problem,
    block: Block,
    objective: Callable[[Evaluation], tuple[float, np.ndarray]],
    iterations: int,
) -> Block:
    def packed(x: np.ndarray, found: Evaluation) -> tuple[float, np.ndarray]:
        value, slope = objective(found)
        return value, gradient_of_block(slope[:, None]).sum(axis=0)

    before = evaluate(problem, block.design, block.angles)
    after = _slsqp(problem, block, packed, iterations, FREEDOM)
    found = evaluate(problem, after.design, after.angles)
    if found.inequalities.min() < -FEASIBLE:
        after = repair(problem, after)
        found = evaluate(problem, after.design, after.angles)
    kept = found.reached.all() and found.inequalities.min() >= -FEASIBLE
    return after if kept and objective(found)[0] < objective(before)[0] else block


def _slsqp(
    problem: Problem,
    block: Block,
    function: Callable[[np.ndarray, Evaluation], tuple[float, np.ndarray]],
    iterations: int,
    freedom: float,
) -> Block:
    observed: dict[bytes, Evaluation] = {}
    last = evaluate(problem, block.design, block.angles)
    last_design = block.design

    def at(x: np.ndarray) -> Evaluation:
        nonlocal last, last_design
        key = x.tobytes()
        if key not in observed:
            observed.clear()
            design = unpack(x)
            change = last.joint_jacobian @ (design - last_design)[..., None]
            far = max(1.0, np.abs(change).max() / FARTHEST)
            observed[key] = evaluate(problem, design, last.chain.angles + change[..., 0] / far)
            if observed[key].reached.all():
                last, last_design = observed[key], design
        return observed[key]

    x0 = pack(block.design)
    box = bounds(problem, len(block.design))
    box = np.column_stack([np.maximum(box[:, 0], x0 - freedom), np.minimum(box[:, 1], x0 + freedom)])
    box = np.sort(box, axis=1)
    result = minimize(
        lambda x: function(x, at(x))[0],
        np.clip(x0, box[:, 0], box[:, 1]),
        jac=lambda x: function(x, at(x))[1],
        bounds=box,
        constraints={
            "type": "ineq",
            "fun": lambda x: at(x).inequalities.ravel(),
            "jac": lambda x: gradient_of_block(at(x).inequality_jacobian),
        },
        method="SLSQP",
        options={"maxiter": iterations, "ftol": 1e-6},
    )
    design = unpack(np.clip(result.x, box[:, 0], box[:, 1]))
    return Block(design, at(pack(design)).chain.angles)
