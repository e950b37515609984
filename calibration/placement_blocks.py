"""Residuals by placement, without the poses of the swing foot.

Errors of a placement's postures are correlated through the recorded plates, those of different placements
are not. The swing foot's x, y and yaw are known up to a constant of each stance: contrasts of the postures
of a stance (Helmert's) are free of it. A restricted likelihood does not depend on which contrasts are used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert

from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import ANCHORED, SIZE, residuals_in_use


@dataclass(frozen=True)
class PlacementBlocks:
    """Map from the residuals of m postures to independent blocks, padded with zeros.

    Attributes:
        postures: postures of each placement, padded with -1, (g, n).
        contrast: rows of each block from the residuals of its postures, (g, r, 11 n); zero where padded.
        padding: which rows of a block are padding, (g, r) bool.
    """

    postures: np.ndarray
    contrast: np.ndarray
    padding: np.ndarray

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Arrange residuals (m, 11) or columns (m, 11, k) by block, (g, r) or (g, r, k)."""
        flat = values[self.postures].reshape(len(self.postures), self.contrast.shape[2], -1)
        return (self.contrast @ flat).reshape(*self.padding.shape, *values.shape[2:])

    def covariance(self, own: np.ndarray) -> np.ndarray:
        """Arrange the covariance of independent errors of each posture, (m, 11, 11), by block, (g, r, r)."""
        g, n = self.postures.shape
        full = np.zeros((g, n, SIZE, n, SIZE))
        each = np.arange(n)
        full[:, each, :, each, :] = own[self.postures].swapaxes(0, 1)
        flat = full.reshape(g, n * SIZE, n * SIZE)
        return self.contrast @ flat @ self.contrast.mT


def placement_blocks(observed: Observation) -> PlacementBlocks:
    """Return the blocks of an experiment's residuals in all channels."""
    used = residuals_in_use(observed)
    placement, stance = observed.measurements.placement, observed.stance
    members = [np.flatnonzero(placement == number) for number in np.unique(placement)]
    n = max(map(len, members))
    anchored = np.zeros(SIZE, bool)
    anchored[ANCHORED] = True
    maps = []
    for inside in members:
        plain = np.flatnonzero(used[inside] & ~anchored)
        rows = [np.eye(SIZE * n)[plain]]
        for number in np.unique(stance[inside]):
            alike = np.flatnonzero((stance[inside] == number) & used[inside, ANCHORED.start])
            for axis in range(ANCHORED.start, ANCHORED.stop) if len(alike) > 1 else ():
                free = np.zeros((len(alike) - 1, SIZE * n))
                free[:, SIZE * alike + axis] = helmert(len(alike))
                rows.append(free)
        maps.append(np.concatenate(rows))
    r = max(map(len, maps))
    return PlacementBlocks(
        postures=np.array([np.append(inside, np.full(n - len(inside), -1)) for inside in members]),
        contrast=np.array([np.pad(each, ((0, r - len(each)), (0, 0))) for each in maps]),
        padding=np.array([np.arange(r) >= len(each) for each in maps]),
    )
