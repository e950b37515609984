"""Total force, centre of pressure and total mass from the eight cell forces (eq. 11)."""

from __future__ import annotations

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements import Measurements


def cell_positions(measurements: Measurements) -> np.ndarray:
    """Return the cells' positions in the base frame from the recorded plate poses, (m, 8, 2) [m]."""
    yaw = measurements.plate_poses[:, :, 2]
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])  # (2, 2, m, plate)
    turned = np.einsum("abmp,pcb->mpca", rotation, measurements.cells)
    return (measurements.plate_poses[:, :, None, :2] + turned).reshape(len(measurements), 8, 2)


def loaded_cells(measurements: Measurements) -> np.ndarray:
    """Return the cells of plates on which a foot stands, (m, 8) bool."""
    stands = np.column_stack([measurements.support != "left", measurements.support != "right"])
    return np.repeat(stands, 4, axis=1)


def loads(measurements: Measurements) -> np.ndarray:
    """Return the cell forces, zero under a foot in the air, (m, 8) [N].

    The cells of an empty plate read noise, which would act on the centre of pressure with a long lever.
    """
    return np.where(loaded_cells(measurements), measurements.cell_forces, 0.0)


def center_of_pressure(measurements: Measurements) -> np.ndarray:
    """Compute the centre of pressure in the base frame (eq. 11), (m, 2) [m].

    Raises:
        InputError: the cells of a posture carry no weight.
    """
    total = loads(measurements).sum(axis=1)
    if (total <= 0).any():
        row = int(np.flatnonzero(total <= 0)[0])
        raise InputError(f"measurements, row {row + 1}: cells sum to {total[row]:.2f} N, expected a weight")
    moment = np.einsum("mc,mca->ma", loads(measurements), cell_positions(measurements))
    return moment / total[:, None]


def load_shares(measurements: Measurements) -> np.ndarray:
    """Return the measured share of the weight on the right and the left plate, (m, 2) [-]."""
    plates = loads(measurements).reshape(-1, 2, 4).sum(axis=2)
    return plates / plates.sum(axis=1, keepdims=True)


def total_mass(measurements: Measurements) -> tuple[float, float]:
    """Return the total mass from the mean force, and its standard error over the postures [kg]."""
    mass = loads(measurements).sum(axis=1) / measurements.gravity
    return float(mass.mean()), float(mass.std(ddof=1) / np.sqrt(len(mass)))
