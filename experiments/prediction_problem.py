"""The data that a prediction has to explain: residuals of the CAD model, and what changes them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters, standard_parameters
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.estimators.prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import carried
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.robot import Robot

SMALLEST = 1e-6  # m: changes and s.d. that count as none


@dataclass(frozen=True, eq=False)
class Problem:
    """The data that the models have to explain.

    Attributes:
        matrix: H, (m, 2, p). residual: of CAD, (m, 2) [m].
        spread: root of the prior's covariance of the base parameters, (p, k) [m].
        zeros: change of the residual by sensors' zeros of which nothing is known, each of size 1, (m, 2, z).
    """

    measurements: Measurements
    robot: Robot
    parameters: BaseParameters
    value: np.ndarray
    matrix: np.ndarray
    residual: np.ndarray
    spread: np.ndarray
    zeros: np.ndarray

    def rows(self, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return the rows of a matrix (m, 2, k) for some postures, (2 n, k)."""
        return values[chosen].reshape(2 * len(chosen), -1)


def problem_of(m: Measurements, robot: Robot, nominal: Nominal) -> Problem:
    """Return what measurements of a robot leave to explain."""
    parameters = nominal.parameters
    unknown = observe(m, nominal).contacts.unsure
    if m.wrenches is None or not unknown.any():
        center, zeros = contact_pressure(m, nominal).center, np.zeros((len(m), 2, 0))
    else:
        center, zeros = _about_zeros(m, nominal, unknown)
    return Problem(
        measurements=m,
        robot=robot,
        parameters=parameters,
        value=nominal.value,
        matrix=parameters.regressor(m.joint_angles, m.support).reshape(len(m), 2, -1),
        residual=center - nominal.center_of_mass(m.joint_angles, m.support),
        spread=cad_spread(parameters, standard_parameters(robot.model)),
        zeros=zeros,
    )


def _about_zeros(m: Measurements, nominal: Nominal, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of pressure, (m, 2) [m], and its change by zeros of size 1, (m, 2, z).

    The vertical forces hold the zeros too: the moments are divided by the robot's weight, so that zeros
    enter linearly.

    Args:
        unknown: channels whose zeros are unknown, (2, c).
    """

    def center(wrenches: np.ndarray) -> np.ndarray:
        other = replace(m, wrenches=wrenches)
        if m.weighed_mass is not None:
            return contact_pressure(other, nominal).center
        observed = observe(other, nominal)
        forces = carried(observed).reshape(len(m), 2, -1)
        total = (forces * observed.contacts.bears).sum(axis=(1, 2))
        return contact_pressure(other, nominal).center * (total / (nominal.mass * m.gravity))[:, None]

    assert m.wrenches is not None
    here, columns = center(m.wrenches), []
    for side, channel in np.argwhere(unknown):
        zero = np.zeros(unknown.shape)
        zero[side, channel] = 1.0
        columns.append(center(m.wrenches + zero) - here)
    if m.weighed_mass is None:  # an error of the weight is no error of the CAD model's centre of mass
        columns.append(-here)
    changes = np.stack(columns, axis=2)
    size = np.sqrt((changes**2).mean(axis=(0, 1)))
    return here, changes[..., size > SMALLEST] / size[size > SMALLEST]


def cad_spread(parameters: BaseParameters, standard: np.ndarray) -> np.ndarray:
    """Return base parameters' changes by one s.d. of every link's mass and centre of mass, (p, 4 n) [m].

    The s.d. are those of the estimator `prior`; one scale of them all is estimated.

    Args:
        standard: (n, 4) [kg, kg m].
    """
    mass, total = standard[:, 0], float(standard[:, 0].sum())
    by_standard = parameters.from_standard.reshape(len(parameters.names), -1, 4)
    value = parameters.values(standard)
    by_mass = np.einsum("pnk,nk->pn", by_standard, standard) - value[:, None] * mass
    by_center = CENTER_SD * by_standard[..., 1:] * mass[:, None]
    return np.hstack([MASS_SD * by_mass, by_center.reshape(len(value), -1)]) / total
