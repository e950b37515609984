"""Estimators of the base parameters with one signature: a `Regression` in, an `Estimate` out."""

from collections.abc import Callable
from dataclasses import dataclass

from tulip_testbed.base.errors import look_up
from tulip_testbed.identification.estimators.errors_in_variables import corrected_least_squares
from tulip_testbed.identification.estimators.estimate import Estimate, StandardEstimate, Unseen
from tulip_testbed.identification.estimators.mixed import mixed_model, placement_effects
from tulip_testbed.identification.estimators.ordinary import huber, least_squares, solve_least_squares
from tulip_testbed.identification.estimators.prior import physically_consistent, with_prior
from tulip_testbed.identification.regressor import Regression


@dataclass(frozen=True)
class Estimator:
    """An estimator and its description in one sentence."""

    run: Callable[[Regression], Estimate]
    summary: str


ESTIMATORS: dict[str, Estimator] = {
    "mixed-model": Estimator(
        mixed_model, "Generalised least squares with placement effects, corrected for encoder errors."
    ),
    "least-squares": Estimator(least_squares, "Ordinary least squares, the paper's eq. 8 and eq. 14."),
    "placement": Estimator(
        placement_effects, "Generalised least squares with placement effects; encoders are assumed exact."
    ),
    "errors-in-variables": Estimator(
        corrected_least_squares, "Least squares corrected for the encoders' errors in the regressor."
    ),
    "robust": Estimator(huber, "Huber's M-estimator, which gives outlying postures less weight."),
    "prior": Estimator(
        with_prior,
        "The mixed model combined with the robot's own model, for link masses and centres of mass.",
    ),
    "consistent": Estimator(
        physically_consistent, "The mixed model projected on robots with positive masses inside their links."
    ),
}
MIXED_MODEL = "mixed-model"


def estimate_by(data: Regression, name: str = MIXED_MODEL) -> Estimate:
    return ESTIMATORS[look_up("estimator", name, ESTIMATORS, "estimator")].run(data)


__all__ = [
    "ESTIMATORS",
    "MIXED_MODEL",
    "Estimate",
    "Estimator",
    "StandardEstimate",
    "Unseen",
    "estimate_by",
    "least_squares",
    "solve_least_squares",
]
