"""Link masses and centres of mass: the measurements combined with the robot's own model as prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.estimators.estimate import Estimate, StandardEstimate
from tulip_testbed.identification.estimators.mixed import mixed_model
from tulip_testbed.identification.estimators.ordinary import residual_sigma
from tulip_testbed.identification.identifiable_masses import identifiable_masses
from tulip_testbed.identification.regressor import Regression

STEPS = 20
CONVERGED = 1e-10


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
