"""What the stated sensor noise does to the centre of pressure and to its model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.center_of_pressure import (
    cell_positions,
    center_of_pressure,
    loaded_cells,
    loads,
)
from tulip_testbed.identification.nominal import Nominal, jacobian
from tulip_testbed.sim.measurements import Measurements


def usable_sd(stated: float | None) -> float | None:
    """A stated s.d. that can be divided by: zero says as little as nothing."""
    return stated if stated else None


@dataclass(frozen=True)
class ReadingNoise:
    """Stated noise of CoP minus modelled CoM.

    Attributes:
        own: covariance of a posture's own errors, of cells and encoders, (m, 2, 2) [m2].
        shared: how one unit of standard error of each recorded plate pose moves the CoP, (m, 2, 6) [m]:
            right plate's x, y, yaw, then the left one's; common to a placement.
        placement: number of each posture's placement, (m,).
    """

    own: np.ndarray
    shared: np.ndarray
    placement: np.ndarray

    def covariance(self) -> np.ndarray:
        """Of the stacked residuals (x, then y), (2m, 2m) [m2]."""
        size = 2 * len(self.own)
        rows = np.arange(size).reshape(-1, 2)
        full = np.zeros((size, size))
        full[rows[:, :, None], rows[:, None, :]] = self.own
        levers = self.shared.reshape(size, 6)
        for placement in np.unique(self.placement):
            inside = np.repeat(self.placement == placement, 2)
            full[np.ix_(inside, inside)] += levers[inside] @ levers[inside].T
        return full


def reading_noise(measurements: Measurements, nominal: Nominal) -> ReadingNoise:
    """What the data sheets state, at the measured postures; unknown s.d. count as zero.

    A cell's error moves the CoP by its lever over the weight; an encoder's moves the modelled CoM.
    """
    m = measurements
    cells = (m.sensors.cell_sd or 0.0) ** 2 * cell_noise(m)
    slope = jacobian(nominal.center_of_mass, m.joint_angles)
    encoders = (m.sensors.encoder_sd or 0.0) ** 2 * slope @ slope.transpose(0, 2, 1)
    return ReadingNoise(cells + encoders, placement_levers(m) * placement_sd(m), m.placement)


def cell_noise(measurements: Measurements, center: np.ndarray | None = None) -> np.ndarray:
    """Covariance of a posture's CoP for independent cells with an s.d. of 1 N, (m, 2, 2) [m2/N2].

    Args:
        center: of pressure, (m, 2) [m]; the measured one if None. Its errors go with the total
            force's: as weights both would pull an estimate towards the plates' middle, so where
            the result is to weigh by, a fitted one is better, and the force is the mean of all.
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
    """How errors of both recorded plate poses move the CoP, (m, 2, 6) [-, -, m].

    Columns: right plate's x, y, yaw, then the left one's.
    """
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
    """S.d. of both recorded plate poses, (6,) [m, m, rad]; zero where unknown.

    The contract states the left plate's only. The right one's foot stands on a mark: it is taken
    to be laid no worse, which errs towards too much noise.
    """
    return np.tile(measurements.sensors.placement_sd or (0.0, 0.0, 0.0), 2)
