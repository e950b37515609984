"""Effect of the stated sensor noise on the centre of pressure and on its model."""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.center_of_pressure import (
    cell_positions,
    center_of_pressure,
    loaded_cells,
    loads,
)
from tulip_testbed.identification.noise_structure import NoiseStructure, Weights, groups
from tulip_testbed.identification.nominal import Nominal, jacobian
from tulip_testbed.measurements import Measurements


@dataclass(frozen=True)
class ReadingNoise:
    """Stated noise of the centre of pressure minus the modelled centre of mass.

    Attributes:
        own: covariance of a posture's own errors, by cells and encoders, (m, 2, 2) [m2].
        shared: displacement of the centre of pressure by one s.d. of each recorded plate pose, (m, 2, 6)
            [m]: x, y, yaw of the right plate, then of the left; common to a placement.
        placement: number of each posture's placement, (m,).
    """

    own: np.ndarray
    shared: np.ndarray
    placement: np.ndarray

    def times(self, columns: np.ndarray) -> np.ndarray:
        """Return the covariance of the stacked residuals times columns, (m, 2, n) [m2]."""
        placement = groups(self.placement)
        common = placement.sums(self.shared.mT @ columns)[placement.number]
        return self.own @ columns + self.shared @ common

    @property
    def variance(self) -> np.ndarray:
        """Return the variance of every residual, (m, 2) [m2]."""
        return np.diagonal(self.own, axis1=1, axis2=2) + (self.shared**2).sum(axis=2)

    @property
    def weights(self) -> Weights:
        """Return the inverse of the covariance; LinAlgError: a posture without noise of its own."""
        m, placement = len(self.own), groups(self.placement)
        nothing = np.zeros((m, 2, 0))
        own, owner = np.zeros((0, m, 2, 2)), np.zeros(self.shared.shape[2], int)
        structure = NoiseStructure(placement, placement, self.own, own, self.shared, owner, nothing)
        return structure.weights(np.zeros(1))


def reading_noise(measurements: Measurements, nominal: Nominal) -> ReadingNoise:
    """Compute the noise that the data sheets state at the measured postures; unknown s.d. count as zero.

    A cell's error displaces the centre of pressure by its lever over the weight; an encoder's error displaces
    the modelled centre of mass.
    """
    m = measurements
    cells = (m.sensors.cell_sd or 0.0) ** 2 * cell_noise(m)
    slope = jacobian(nominal.center_of_mass, m.joint_angles)
    encoders = (m.sensors.encoder_sd or 0.0) ** 2 * slope @ slope.transpose(0, 2, 1)
    return ReadingNoise(cells + encoders, placement_levers(m) * placement_sd(m), m.placement)


def cell_noise(measurements: Measurements, center: np.ndarray | None = None) -> np.ndarray:
    """Return the covariance of each posture's centre of pressure for cells with an s.d. of 1 N.

    Args:
        center: centre of pressure, (m, 2) [m]; None means the measured one. Its errors correlate with those
            of the total force: weights from both would pull an estimate towards the middle of the plates. For
            weights, give a fitted centre; the force is then the mean of all postures.

    Returns:
        Covariances, (m, 2, 2) [m2/N2].
    """
    m = measurements
    force = loads(m).sum(axis=1)
    if center is None:
        center = center_of_pressure(m)
    else:
        force = np.full(len(m), force.mean())
    lever = loaded_cells(m)[..., None] * (cell_positions(m) - center[:, None]) / force[:, None, None]
    return np.einsum("mca,mcb->mab", lever, lever)


def placement_levers(measurements: Measurements) -> np.ndarray:
    """Return displacements of the CoP by x, y, yaw of right and left plate, (m, 2, 6) [-, -, m]."""
    m = measurements
    forces = loads(m).reshape(-1, 2, 4)
    share = forces.sum(axis=2) / forces.sum(axis=(1, 2))[:, None]
    arms = cell_positions(m).reshape(-1, 2, 4, 2) - m.plate_poses[:, :, None, :2]
    moment = np.einsum("mpc,mpca->mpa", forces, arms) / forces.sum(axis=(1, 2))[:, None, None]
    levers = np.zeros((len(m), 2, 6))
    for plate in (0, 1):
        levers[:, 0, 3 * plate] = levers[:, 1, 3 * plate + 1] = share[:, plate]
        levers[:, 0, 3 * plate + 2] = -moment[:, plate, 1]
        levers[:, 1, 3 * plate + 2] = moment[:, plate, 0]
    return levers


def placement_sd(measurements: Measurements) -> np.ndarray:
    """Return the s.d. of both recorded plate poses, (6,) [m, m, rad]; zero where unknown.

    The contract states the left plate's s.d. only. The foot on the right plate stands on a mark; the same
    s.d. is assumed for it, which rather overestimates the noise.
    """
    return np.tile(measurements.sensors.known_placement_sd, 2)
