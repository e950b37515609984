"""Which combinations of base parameters cannot be told from the unknown zeros of force-torque sensors."""

from __future__ import annotations

import numpy as np

from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.rank import undetermined_directions
from tulip_testbed.identification.regressor import Regression
from tulip_testbed.identification.residual_channels import by_weight, fields, sensitivity

SINGULAR = 1e-9  # relative
NOT_LEVEL = 1e-4  # relative: the square of a tilt of half a degree


def zero_columns(observed: Observation) -> np.ndarray:
    """Return how zeros of which nothing is known change centre of pressure and weight, (m, 3, z).

    There is a column for every channel whose zero was neither stated nor shown by a foot in the air.
    """
    readings = observed.contacts
    if readings.unknown is None or readings.by_channel is None:
        return np.zeros((len(observed), 3, 0))
    k, by_channel = len(readings.by_channel), readings.by_channel
    by_reading = sensitivity(observed, observed.nominal.value)[:, :3, fields(observed)["cells"]]
    sides = [by_reading[..., k * s : k * (s + 1)] @ by_channel[:, readings.unknown[s]] for s in (0, 1)]
    return np.concatenate(sides, axis=2)


def confounded_directions(observed: Observation, data: Regression) -> np.ndarray:
    """Return a basis of the directions that the zeros imitate, (d, p); d = 0 without unknown zeros.

    They are those that the regressor does not determine once the zeros' columns, in the centre of pressure
    and in the sum of the forces, are projected out.
    """
    m, p = len(observed), data.matrix.shape[1]
    columns = zero_columns(observed)
    if not columns.shape[2]:
        return np.zeros((0, p))
    if observed.measurements.weighed_mass is None:  # the weight is unknown too
        columns = np.concatenate([columns, by_weight(observed)[..., None]], axis=2)
    columns[:, 2] /= observed.weight
    whole = np.concatenate([data.matrix.reshape(m, 2, p), np.zeros((m, 1, p))], axis=1).reshape(-1, p)
    basis, size, _ = np.linalg.svd(columns.reshape(3 * m, -1), full_matrices=False)
    basis = basis[:, size > SINGULAR * size[0]]
    # What is left of a column that was projected out because a measured sole is not quite level.
    left = np.diag(NOT_LEVEL * np.linalg.norm(whole, axis=0))
    blur = left if data.blur is None else np.vstack([data.blur, left])
    return undetermined_directions(whole - basis @ (basis.T @ whole), blur)
