"""Optimise the whole plan by IPOPT through casadi (the extra `opt`).

The Jacobian of the constraints is sparse by blocks, since a posture depends on its own and its swing foot's
variables only. The Hessian is approximated (limited-memory BFGS).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.planning.blocks import FARTHEST, SCALE, information, information_slope
from tulip_testbed.identification.planning.constraints import Evaluation
from tulip_testbed.identification.planning.linear_steps import EvaluatedPlan, evaluate_plan, variables
from tulip_testbed.identification.planning.objectives import Smooth
from tulip_testbed.identification.planning.problem import PlanningProblem

OPTIONS = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.mu_strategy": "adaptive",
    "ipopt.tol": 1e-5,
    "ipopt.bound_relax_factor": 0.0,
}


def casadi_module() -> Any:
    """Import the optional library casadi.

    Raises:
        InputError: it is not installed.
    """
    try:
        import casadi
    except ImportError:
        raise InputError("solver ipopt: casadi is missing; install the extra 'opt'") from None
    return casadi


def interior_point(
    problem: PlanningProblem, plan: EvaluatedPlan, smooth: Smooth, iterations: int
) -> EvaluatedPlan:
    """Minimise a function of the plan's information under all constraints.

    Returns:
        The last iterate of IPOPT, which may be slightly infeasible.
    """
    casadi = casadi_module()
    count, slots = plan.evaluation.inequalities.shape
    columns, size = variables(plan)
    rows = np.repeat(np.arange(count * slots), 9)
    across = np.repeat(columns, slots, axis=0).ravel()
    order = np.lexsort((rows, across))  # casadi stores by columns
    sparsity = casadi.Sparsity.triplet(count * slots, size, rows[order].tolist(), across[order].tolist())
    last, cache = plan, dict[bytes, EvaluatedPlan]()

    def design_at(x: np.ndarray) -> np.ndarray:
        return x[columns] * SCALE

    def at(x: np.ndarray) -> Evaluation:
        nonlocal last
        if x.tobytes() not in cache:
            design = design_at(x)
            change = (last.evaluation.joint_jacobian @ (design - last.design)[..., None])[..., 0]
            change /= max(1.0, float(np.abs(change).max()) / FARTHEST)
            cache.clear()
            cache[x.tobytes()] = evaluate_plan(
                problem, design, last.evaluation.chain.angles + change, plan.per
            )
            if cache[x.tobytes()].evaluation.reached.all():
                last = cache[x.tobytes()]
        return cache[x.tobytes()].evaluation

    def slope(x: np.ndarray) -> np.ndarray:
        evaluation = at(x)
        _, by_matrix = smooth(information(evaluation))
        total = np.zeros(size)
        np.add.at(total, columns, information_slope(evaluation, by_matrix) * SCALE)
        return total[None]

    def inequality_jacobian(x: np.ndarray) -> Any:
        values = (at(x).inequality_jacobian * SCALE).reshape(-1)
        return casadi.DM(sparsity, values[order])

    value = _function(casadi, "f", size, casadi.Sparsity.dense(1, 1), lambda x: smooth(information(at(x)))[0])
    value.slope = _function(casadi, "jac_f", size, casadi.Sparsity.dense(1, size), slope)
    keeps = _function(
        casadi, "g", size, casadi.Sparsity.dense(count * slots, 1), lambda x: at(x).inequalities.ravel()
    )
    keeps.slope = _function(casadi, "jac_g", size, sparsity, inequality_jacobian)

    x0 = np.zeros(size)
    x0[columns] = plan.design / SCALE
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    intervals = np.concatenate([problem.ranges.torso, problem.ranges.swing])
    low[columns[:, 3:]], high[columns[:, 3:]] = (intervals.T[:, None] / SCALE[3:]).repeat(count, axis=1)
    x = casadi.MX.sym("x", size)
    solver = casadi.nlpsol(
        "plan", "ipopt", {"x": x, "f": value(x), "g": keeps(x)}, OPTIONS | {"ipopt.max_iter": iterations}
    )
    answer = solver(x0=x0, lbx=low, ubx=high, lbg=0.0, ubg=np.inf)
    at(np.clip(np.array(answer["x"]).ravel(), low, high))
    return next(iter(cache.values()))


def _function(casadi: Any, name: str, size: int, shape: Any, compute: Any) -> Any:
    """Make a function of x that casadi can call; its `slope`, if set, is another such function."""

    class Function(casadi.Callback):  # casadi requires a subclass
        slope: Any = None

        def __init__(self) -> None:
            casadi.Callback.__init__(self)
            self.construct(name, {})

        def get_n_in(self) -> int:
            return 1 if not name.startswith("jac_") else 2

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int) -> Any:
            if i == 0:
                return casadi.Sparsity.dense(size, 1)
            return casadi.Sparsity(shape.size1(), 1)

        def get_sparsity_out(self, i: int) -> Any:
            return shape

        def eval(self, arguments: Any) -> list[Any]:
            return [compute(np.array(arguments[0]).ravel())]

        def has_jacobian(self) -> bool:
            return not name.startswith("jac_")

        def get_jacobian(self, name: str, inputs: Any, outputs: Any, options: Any) -> Any:
            return self.slope

    return Function()
