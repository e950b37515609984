"""Physically consistent base parameters: the nearest to the estimate that a real robot can have."""

from dataclasses import replace

import numpy as np
import scipy

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.estimators.estimate import Estimate
from tulip_testbed.identification.estimators.mixed import mixed_model
from tulip_testbed.identification.estimators.ordinary import residual_sigma
from tulip_testbed.identification.nominal import SIDES, link_boxes
from tulip_testbed.identification.regressor import Regression

EQUALITY = 1e4  # weight of the equation "mass fractions sum to one" over the largest other weight


def physically_consistent(data: Regression) -> Estimate:
    """Project the default estimate on robots with positive masses inside their links' boxes.

    A link with its centre of mass in its box is equivalent to non-negative point masses on the box's
    corners. So the reachable base parameters are theta = B G w, w >= 0, sum w = 1, and the nearest of them in
    the metric of the estimate's covariance follow from non-negative least squares (Lawson and Hanson 1974).
    The standard errors are those before the projection, which are too large where it changed the estimate.
    """
    found = mixed_model(data)
    reachable = corner_parameters(data)
    deviation = np.sqrt(np.diag(found.covariance))
    root = np.linalg.cholesky(found.covariance / np.outer(deviation, deviation))
    # Distances from the estimate: the target is zero, and rounding errors stay small relative to it.
    away = np.linalg.solve(root, (reachable - found.value[:, None]) / deviation[:, None])
    size = np.abs(away).max()
    weights, _ = scipy.optimize.nnls(
        np.vstack([away / size, np.full(away.shape[1], EQUALITY)]), np.append(np.zeros(len(away)), EQUALITY)
    )
    value = reachable @ weights / weights.sum()
    residual, sigma, _ = residual_sigma(data, value)
    return replace(found, value=value, residual=residual, sigma=sigma)


def corner_parameters(data: Regression) -> np.ndarray:
    """Return the base parameters of robots with all mass on one corner of a link's box, (p, 8 n) [m].

    The n links are those that have a mass.
    """
    if data.robot is None or data.parameters is None:
        raise InputError(f"{data.source}: found no robot, expected one, whose link boxes are the bounds")
    boxes = link_boxes(data.robot.visual_model)
    corners = np.where(SIDES[None] < 0, boxes[:, None, 0], boxes[:, None, 1])  # (n, 8, 3)
    heavy = np.flatnonzero(data.robot.model.body_mass[1:] > 0)
    standard = np.zeros((len(boxes), 4, len(heavy), 8))
    for k, link in enumerate(heavy):
        standard[link, 0, k] = 1.0
        standard[link, 1:, k] = corners[link].T
    rows = data.parameters.from_standard[data.numbers - 1]
    return rows @ standard.reshape(4 * len(boxes), 8 * len(heavy))
