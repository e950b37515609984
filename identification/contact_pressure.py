"""The centre of pressure of an experiment and how errors of its sensors move it, for any kind of sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.center_of_pressure import center_of_pressure, load_shares, total_mass
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import carried, fields, sensitivity
from tulip_testbed.measurements import Measurements


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


def contact_pressure(measurements: Measurements, nominal: Nominal) -> ContactPressure:
    """Return centre of pressure, load and mass by the contacts.

    The moments of wrench sensors are divided by the weighed weight, if there is one: it has less noise.

    Raises:
        InputError: the contacts of a posture carry no weight.
    """
    if measurements.contacts is None:
        shares = load_shares(measurements)
        return ContactPressure(center_of_pressure(measurements), shares, total_mass(measurements))
    observed = observe(measurements, nominal)
    forces = carried(observed).reshape(len(observed), 2, -1)
    down = (forces * observed.contacts.bears).sum(axis=2)
    total = down.sum(axis=1)
    mass = total / measurements.gravity
    error = float(mass.std(ddof=1) / np.sqrt(len(mass)))
    moment = (carried(observed)[..., None] * observed.cell_places).sum(axis=1)
    weight = total if measurements.weighed_mass is None else np.full(len(total), observed.weight)
    return ContactPressure(moment / weight[:, None], down / total[:, None], (float(mass.mean()), error))


def center_slopes(observed: Observation) -> dict[str, np.ndarray]:
    """Differentiate the residual of the centre of pressure by angles, readings and poses, (m, 2, k) each.

    The names are those of `residual_channels.fields`.
    """
    slope, at = sensitivity(observed, observed.nominal.value)[:, :2], fields(observed)
    return {name: slope[..., at[name]] for name in ("angles", "cells", "plates")}


def wrench_noise(observed: Observation, by_reading: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Return the covariance of each posture's centre of pressure for readings with an s.d. of 1, (m, 2, 2).

    Args:
        by_reading: of `center_slopes`.
        fitted: centre of pressure without noise, see `cell_noise`, (m, 2) [m].
    """
    lever = by_reading
    if observed.measurements.weighed_mass is None:  # the centre of pressure is that over the measured force
        lever = lever - observed.contacts.bears.ravel() * fitted[..., None] / observed.weight
    return lever @ lever.mT


def zero_columns(observed: Observation) -> np.ndarray:
    """Return how zeros of which nothing is known change centre of pressure and weight, (m, 3, z).

    There is a column for every channel whose zero was neither stated nor shown by a foot in the air.
    """
    found = observed.contacts
    if found.unknown is None or found.by_channel is None:
        return np.zeros((len(observed), 3, 0))
    k = len(found.by_channel)
    by_reading = sensitivity(observed, observed.nominal.value)[:, :3, fields(observed)["cells"]]
    return np.concatenate(
        [by_reading[..., k * s : k * (s + 1)] @ found.by_channel[:, found.unknown[s]] for s in (0, 1)], axis=2
    )
