"""Centre of pressure, load and total mass by the contacts: eight cells (eq. 11) or any kind of sensor."""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.observation import Observation, turned
from tulip_testbed.identification.residual_channels import carried, fields, sensitivity
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import feet_in_contact


def cell_positions(measurements: Measurements) -> np.ndarray:
    """Return the cells' positions in the base frame from the recorded plate poses, (m, 8, 2) [m]."""
    poses = measurements.plate_poses[:, :, None]
    return (poses[..., :2] + turned(poses[..., 2], measurements.cells[None])).reshape(-1, 8, 2)


def loaded_cells(measurements: Measurements) -> np.ndarray:
    """Return the cells of plates on which a foot stands, (m, 8) bool."""
    return np.repeat(feet_in_contact(measurements.support), 4, axis=1)


def loads(measurements: Measurements) -> np.ndarray:
    """Return the cell forces, zero under a foot in the air, (m, 8) [N].

    The cells of an empty plate read noise, which would act on the centre of pressure with a long lever.
    """
    return np.where(loaded_cells(measurements), measurements.cell_forces, 0.0)


def center_of_pressure(measurements: Measurements) -> np.ndarray:
    """Compute the centre of pressure in the base frame (eq. 11), (m, 2) [m]."""
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
    return _mean_and_error(mass)


def _mean_and_error(values: np.ndarray) -> tuple[float, float]:
    """Return the mean and its standard error; NaN of a single value."""
    few = len(values) < 2
    return float(values.mean()), np.nan if few else float(values.std(ddof=1) / np.sqrt(len(values)))


@dataclass(frozen=True)
class ContactPressure:
    """The data about the contacts that a regression needs.

    Attributes:
        center: centre of pressure in the base frame, (m, 2) [m].
        load_share: share of the weight on the right and left foot, (m, 2) [-].
        mass: total mass by the contacts and its standard error [kg].
    """

    center: np.ndarray
    load_share: np.ndarray
    mass: tuple[float, float]


def contact_pressure(observed: Observation) -> ContactPressure:
    """Return centre of pressure, load and mass by the contacts.

    The moments of wrench sensors are divided by the weighed weight and the vertical inertial force by CAD, if
    there is one: both have less noise. The inertial part by CAD is taken off.
    """
    measurements = observed.measurements
    if measurements.contacts is None:
        center = center_of_pressure(measurements) - observed.shift
        return ContactPressure(center, load_shares(measurements), total_mass(measurements))
    forces = carried(observed)
    down = (forces.reshape(len(observed), 2, -1) * observed.contacts.bears).sum(axis=2)
    total = down.sum(axis=1)
    mass = total / measurements.gravity
    moment = (forces[..., None] * observed.cell_places).sum(axis=1)
    force = total if measurements.weighed_mass is None else observed.weight + observed.lift
    center = moment / force[:, None] - observed.shift
    return ContactPressure(center, down / total[:, None], _mean_and_error(mass))


def center_slopes(observed: Observation) -> dict[str, np.ndarray]:
    """Differentiate the residual of the centre of pressure by angles, readings and poses, (m, 2, k) each.

    The names are those of `residual_channels.fields`.
    """
    slope, at = sensitivity(observed, observed.nominal.value)[:, :2], fields(observed)
    return {name: slope[..., at[name]] for name in ("angles", "cells", "plates")}


def wrench_noise(observed: Observation, by_reading: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Return the covariance of each posture's centre of pressure for readings with an s.d. of 1, (m, 2, 2).

    The slopes are those of `center_slopes`; the fitted centre is that without noise, see `cell_noise`.
    """
    lever = by_reading
    if observed.measurements.weighed_mass is None:  # the centre of pressure is that over the measured force
        lever = lever - observed.contacts.bears.ravel() * fitted[..., None] / observed.weight
    return lever @ lever.mT
