"""Estimators of the base parameters behind one signature: a `Regression` in, an `Estimate` out."""

from collections.abc import Callable
from dataclasses import dataclass

from identification.estimators.estimate import Estimate, StandardEstimate
from identification.estimators.mixed import mixed_model, placement_effects
from identification.estimators.ordinary import least_squares, solve_least_squares
from identification.regressor import Regression
from sim.errors import look_up


@dataclass(frozen=True)
class Estimator:
    """An estimator and what it is, in a sentence."""

    run: Callable[[Regression], Estimate]
    summary: str


ESTIMATORS: dict[str, Estimator] = {
    "mixed-model": Estimator(
        mixed_model, "Generalised least squares with placement effects, corrected for encoder errors."
    ),
    "least-squares": Estimator(least_squares, "Ordinary least squares, the paper's eq. 8 and eq. 14."),
    "placement": Estimator(
        placement_effects, "Generalised least squares with placement effects; encoders count as exact."
    ),
}
DEFAULT = "mixed-model"


def estimate(data: Regression, name: str = DEFAULT) -> Estimate:
    """Run an estimator by its name.

    Raises:
        InputError: an unknown name (lists the valid ones), or postures that do not suffice.
    """
    return ESTIMATORS[look_up("estimator", name, ESTIMATORS, "--estimator")].run(data)


__all__ = [
    "DEFAULT",
    "ESTIMATORS",
    "Estimate",
    "Estimator",
    "StandardEstimate",
    "estimate",
    "least_squares",
    "solve_least_squares",
]
