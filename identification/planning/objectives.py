"""Objectives of an optimal plan as functions of the information matrix M = H'H.

Each function returns its value and its symmetric gradient G = df/dM. Objectives that are not smooth are
approximated by smooth ones: the p-norms of the eigenvalues of M and M^-1 tend to the largest ones, so
(1/p) ln(tr M^p tr M^-p) tends to ln cond(M) (p = 1: ln tr M tr M^-1).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

Smooth = Callable[[np.ndarray], tuple[float, np.ndarray]]
Value = Callable[[np.ndarray], float]
POWERS = (1, 2, 4, 8, 16)  # of the p-norms, in this order
PENALTY = 0.1
SINGULAR = 1e-14  # of the largest eigenvalue


@dataclass(frozen=True)
class Objective:
    """An objective by its name.

    Attributes:
        value: reported value, by which plans are compared; smaller is better.
        smooth: smooth functions that are minimised in turn, each from the result of the last.
        known: information that is there in any case, which all of these add, (p, p).
        penalty: weight of a posture's largest violation of a constraint in linear steps.
    """

    name: str
    value: Value
    smooth: tuple[Smooth, ...]
    known: np.ndarray | float = 0.0
    penalty: float = PENALTY

    def condition_number(self, information: np.ndarray) -> float:
        """Return the condition number of H, that of the known information included [-]."""
        return condition_number(self.known + information)


def condition_number(information: np.ndarray) -> float:
    """Return the condition number of H from M = H'H (the paper's objective) [-]."""
    values = np.linalg.eigvalsh(information)
    return float(np.sqrt(values[-1] / values[0])) if values[0] > SINGULAR * values[-1] else np.inf


def shifted(smooth: Smooth, rest: np.ndarray | float) -> Smooth:
    """Return a function of a part's information, given that of the rest, (p, p)."""
    return lambda part: smooth(rest + part)


def given(objective: Objective, rest: np.ndarray | float) -> Objective:
    """Return the objective of the whole plan as one of a part, given the information of the rest, (p, p)."""
    return replace(
        objective,
        value=lambda part: objective.value(rest + part),
        smooth=tuple(shifted(smooth, rest) for smooth in objective.smooth),
        known=objective.known + rest,
    )


def _condition(power: int) -> Smooth:
    def smooth(information: np.ndarray) -> tuple[float, np.ndarray]:
        values, turn = _eigen(information)
        large, small = values / values[-1], values[0] / values
        top, bottom = (large**power).sum(), (small**power).sum()
        value = np.log(values[-1] / values[0]) + np.log(top * bottom) / power
        slope = large**power / top / values - small**power / bottom / values
        return float(value) / 2, (turn * slope) @ turn.T / 2

    return smooth


def _d_optimal(information: np.ndarray) -> tuple[float, np.ndarray]:
    values, turn = _eigen(information)
    count = len(values)
    return float(-np.log(values).sum()) / count, -(turn / values) @ turn.T / count


def _a_optimal(information: np.ndarray) -> tuple[float, np.ndarray]:
    values, turn = _eigen(information)
    trace = (1 / values).sum()
    return float(np.log(trace)), -(turn / values**2) @ turn.T / trace


def _worst(power: int) -> Smooth:
    def smooth(information: np.ndarray) -> tuple[float, np.ndarray]:
        values, turn = _eigen(information)
        inverse = (turn / values) @ turn.T
        diagonal = np.diag(inverse)
        most = diagonal.max()
        norm = ((diagonal / most) ** power).sum()
        weight = (diagonal / most) ** (power - 1) / (norm * most)
        value = np.log(most) + np.log(norm) / power
        return float(value) / 2, -(inverse * weight) @ inverse / 2

    return smooth


def objectives(sigma: float) -> dict[str, Objective]:
    """Return the objectives by name, with the s.d. of a coordinate of the centre of pressure [m]."""

    def standard_errors(information: np.ndarray) -> np.ndarray:
        if not np.isfinite(condition_number(information)):
            return np.full(len(information), np.inf)
        return sigma * np.sqrt(np.diag(np.linalg.inv(information)))

    listed = (
        Objective("condition", condition_number, tuple(_condition(p) for p in POWERS)),
        Objective("d-optimal", lambda m: _d_optimal(m)[0], (_d_optimal,)),
        Objective("a-optimal", lambda m: float(np.linalg.norm(standard_errors(m))), (_a_optimal,)),
        Objective(
            "worst-standard-error",
            lambda m: float(standard_errors(m).max()),
            tuple(_worst(p) for p in POWERS),
        ),
    )
    return {objective.name: objective for objective in listed}


def _eigen(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values, turn = np.linalg.eigh(information)
    return np.maximum(values, SINGULAR * values[-1]), turn
