"""Estimates with knowledge of the robot: its own model as prior, and link boxes that hold every mass."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.base_parameters import BaseParameters, standard_parameters
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.estimators.estimate import Estimate, StandardEstimate
from tulip_testbed.identification.estimators.mixed import mixed_model
from tulip_testbed.identification.estimators.ordinary import residual_sigma
from tulip_testbed.identification.nominal import SIDES, link_boxes
from tulip_testbed.identification.rank import reduced_basis
from tulip_testbed.identification.regressor import Regression

STEPS = 20
CONVERGED = 1e-10
RELATIVE = 1e-9
EQUALITY = 1e4  # weight of the equation "mass fractions sum to one" over the largest other weight


def with_prior(data: Regression) -> Estimate:
    """Estimate masses and centres of mass with a Gaussian prior by Gauss-Newton (iterated Kalman update).

    The prior has an s.d. of 20 % for every link's mass and of 20 mm for its centre of mass about the robot's
    file, all independent. The data are the base parameters of the default estimator with their covariance,
    and the total mass.
    """
    found = mixed_model(data)
    if data.robot is None or data.parameters is None or data.mass is None:
        raise InputError(f"{data.source}: found no robot, expected one: its own model is the prior")
    links = data.parameters.tree.links
    standard = standard_parameters(data.robot.model)
    mass = standard[:, 0]
    center = np.divide(standard[:, 1:], mass[:, None], out=np.zeros((len(mass), 3)), where=mass[:, None] > 0)
    start = np.column_stack([mass, center])
    deviation = np.column_stack([MASS_SD * mass, np.full(center.shape, CENTER_SD)]).ravel()
    prior = np.diag(deviation**2)
    total, total_sd = data.mass
    noise = np.zeros((len(found.value) + 1,) * 2)
    noise[:-1, :-1], noise[-1, -1] = found.covariance, total_sd**2
    observed = np.append(found.value, total)
    from_standard = data.parameters.from_standard[found.numbers - 1]

    state = start.copy()
    for _ in range(STEPS):
        predicted, slope = _predict(state, from_standard)
        scale = np.sqrt(np.diag(slope @ prior @ slope.T + noise))
        spread = (slope @ prior @ slope.T + noise) / np.outer(scale, scale)
        gain = np.linalg.lstsq(spread, slope @ prior / scale[:, None], rcond=None)[0].T / scale
        fresh = start + (gain @ (observed - predicted + slope @ (state - start).ravel())).reshape(start.shape)
        change, state = np.abs((fresh - state).ravel() / np.maximum(deviation, 1e-300)), fresh
        if change.max() < CONVERGED:
            break
    predicted, slope = _predict(state, from_standard)
    posterior = prior - gain @ slope @ prior
    posterior = (posterior + posterior.T) / 2
    variance = np.maximum(np.diag(posterior), 0.0).reshape(start.shape)
    before = (deviation**2).reshape(start.shape)
    share = np.where(before > 0, 1 - variance / np.where(before > 0, before, 1.0), 0.0)
    error = np.sqrt(variance)
    value, covariance = predicted[:-1], (slope @ posterior @ slope.T)[:-1, :-1]
    residual, sigma, _ = residual_sigma(data, value)
    return replace(
        found,
        value=value,
        covariance=covariance,
        clustered_covariance=covariance,
        residual=residual,
        sigma=sigma,
        standard=StandardEstimate(
            links=links,
            mass=state[:, 0],
            mass_error=error[:, 0],
            mass_share=share[:, 0],
            center=state[:, 1:],
            center_error=error[:, 1:],
            center_share=share[:, 1:],
            identifiable=identifiable_masses(data.parameters).sentence,
        ),
    )


def _predict(state: np.ndarray, from_standard: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return base parameters and total mass of (mass, centre) per link, (n, 4), and their derivative."""
    mass, total = state[:, 0], state[:, 0].sum()
    standard = np.column_stack([mass, mass[:, None] * state[:, 1:]])
    value = from_standard @ standard.ravel() / total
    count = len(state)
    turn = np.zeros((count, 4, count, 4))
    each = np.arange(count)
    turn[each, 0, each, 0] = 1.0
    turn[each, 1:, each, 0] = state[:, 1:]
    for axis in (1, 2, 3):
        turn[each, axis, each, axis] = mass
    sums = np.zeros((count, 4))
    sums[:, 0] = 1.0
    slope = (from_standard @ turn.reshape(4 * count, 4 * count) - np.outer(value, sums.ravel())) / total
    return np.append(value, total), np.vstack([slope, sums.ravel()])


@dataclass(frozen=True)
class IdentifiableMasses:
    """Combinations of link masses that base parameters and total mass determine.

    Attributes:
        links: names of the links, (n,).
        combinations: weights of the masses in each combination, (k, n); the total mass is one of them.
    """

    links: tuple[str, ...]
    combinations: np.ndarray

    @property
    def alone(self) -> tuple[str, ...]:
        """Return the links whose own mass is determined."""
        single = self.combinations[(np.abs(self.combinations) > RELATIVE).sum(axis=1) == 1]
        return tuple(self.links[k] for k in np.flatnonzero((np.abs(single) > RELATIVE).any(axis=0)))

    @property
    def sentence(self) -> str:
        count = len(self.combinations)
        if count == 1:
            return (
                "The measurements determine the total mass but no single link mass; "
                "link masses are those of the prior, adjusted."
            )
        known = f" ({', '.join(self.alone)} alone)" if self.alone else ""
        return (
            f"The measurements determine {count} combinations of the {len(self.links)} link masses{known}; "
            "everything else about the masses comes from the prior."
        )


def identifiable_masses(parameters: BaseParameters) -> IdentifiableMasses:
    """Find the combinations of masses that do not depend on any centre of mass, structurally.

    A combination w'm is determined if it is constant under every change of the standard parameters that
    leaves base parameters and total mass unchanged.
    """
    links = parameters.tree.links
    total = np.zeros((len(links), 4))
    total[:, 0] = 1.0
    determined = np.vstack([parameters.from_standard, total.ravel()])
    _, size, turned = np.linalg.svd(determined)
    rank = int((size > RELATIVE * size[0]).sum())
    free = turned[rank:].reshape(-1, len(links), 4)[:, :, 0]  # masses in the undetermined directions
    if not len(free):
        return IdentifiableMasses(links, np.eye(len(links)))
    _, size, turned = np.linalg.svd(free)
    rank = int((size > RELATIVE).sum())
    return IdentifiableMasses(links, reduced_basis(turned[rank:]))


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
    """Return base parameters of robots with all mass on a corner of one of n links' boxes, (p, 8 n) [m]."""
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
