"""Loads from the estimated robot: the gravity's torques depend on the base parameters alone.

A joint that yields is a softer servo: the closed legs share their internal forces by the compliances of
servos and joints in series.

An observation computes loads from standard parameters. Here they are the robot's own model, corrected by the
estimated base parameters: their mean given the estimate, if the model's masses are uncertain by 20 % and its
centres of mass by 20 mm. Where the data determine the base parameters, torques are theirs; elsewhere the
model's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.estimators.prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.observation import Observation

SCALE_SD = 1e-3  # relative, of the total mass, which is weighed


def with_estimated_loads(
    observed: Observation, theta: np.ndarray, covariance: np.ndarray, compliance: np.ndarray
) -> Observation:
    """Return the observation with the loads of the estimated robot.

    Args:
        theta: base parameters, (p,) [m].
        covariance: of theta, (p, p) [m2].
        compliance: of the joints between encoder and link, (n_joints,) [rad/Nm].
    """
    stiffness = 1 / (1 / observed.servo_gain + np.maximum(compliance, 0.0))
    model = standard_parameters(observed.nominal.robot.model)
    mass = model[:, 0]
    total = observed.weight / observed.measurements.gravity
    model = model * (total / mass.sum())
    mass = model[:, 0]
    # A mass moves its centre's moment with it.
    spread = np.zeros((*model.shape, 4))
    spread[:, :, 0] = MASS_SD * model
    for axis in (1, 2, 3):
        spread[:, axis, axis] = CENTER_SD * mass
    n = len(model)
    prior = np.zeros((n, 4, n, 4))
    each = np.arange(n)
    prior[each, :, each, :] = spread @ spread.mT
    prior = prior.reshape(4 * n, 4 * n)
    seen = np.vstack([observed.nominal.parameters.from_standard / total, np.tile([1.0, 0, 0, 0], n)])
    noise = np.zeros((len(seen), len(seen)))
    noise[:-1, :-1] = covariance
    noise[-1, -1] = (SCALE_SD * total) ** 2
    innovation = np.append(theta, total) - seen @ model.ravel()
    gain = np.linalg.solve(seen @ prior @ seen.T + noise, innovation)
    standard = model + (prior @ seen.T @ gain).reshape(-1, 4)
    return replace(observed, standard=standard, servo_stiffness=stiffness)
