"""Predict the covariance of generalised least squares from the sensors' s.d., without any Monte Carlo."""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.reading_noise import cell_noise, placement_levers
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.sensors import averaged_sd


def predicted_covariance(
    rig: Rig, measured: Measurements, parameters: BaseParameters, value: np.ndarray
) -> np.ndarray:
    """Compute (H' V^-1 H)^-1 of generalised least squares with V by the sensors' true s.d., (p, p) [m2].

    Args:
        value: true parameters, (p,) [m].
    """
    s, samples = rig.sensors, round(rig.protocol.window * rig.sensors.sample_rate)
    cell = averaged_sd(s.cell_repeatability, s.cell_noise, s.cell_resolution, samples)
    encoder = averaged_sd(s.encoder_repeatability, s.encoder_noise, s.encoder_resolution, samples)
    cells = cell_noise(measured)
    slope = encoder * (parameters.slope(measured.joint_angles) @ value)
    own = cell**2 * cells + slope @ slope.mT
    levers = placement_levers(measured) * np.array([*s.mark_sd, *s.placement_sd])
    matrix = parameters.regressor(measured.joint_angles)
    information = np.zeros((len(value), len(value)))
    for number in np.unique(measured.placement):
        rows = measured.placement == number
        h = matrix[rows].reshape(-1, len(value))
        information += h.T @ np.linalg.solve(_covariance(own[rows], levers[rows]), h)
    return np.linalg.inv(information)


def _covariance(own: np.ndarray, levers: np.ndarray) -> np.ndarray:
    """Assemble the covariance of the CoP of one placement, (2m, 2m)."""
    size = 2 * len(own)
    rows, flat = np.arange(size).reshape(-1, 2), levers.reshape(size, -1)
    covariance = flat @ flat.T
    covariance[rows[:, :, None], rows[:, None, :]] += own
    return covariance
