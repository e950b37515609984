"""How the residuals change with the members of the families."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.calibration.families import Family
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import SIZE, difference, residuals

STEP = 1e-2  # of an effect's plausible size, of the difference quotient


def member_columns(
    observed: Observation, theta: np.ndarray, sensitivity: np.ndarray, families: Sequence[Family | FreeEffect]
) -> np.ndarray:
    """Differentiate the residuals by every number of the families, (m, 11, q) per SI unit.

    Args:
        observed: readings with little noise, from which the members are removed as far as they are known.
        theta: base parameters, (p,) [m].
        sensitivity: derivative of the residuals by the fields of `packed`, (m, 11, k).
    """
    columns, before = [], residuals(observed, theta)
    for family in families:
        for number, size in enumerate(STEP * family.steps):
            one = family.one(number, float(size))
            after = one.effect.predict(observed, one.target, one.values)
            if after.tree is observed.tree and after.cells is observed.cells:
                change = difference(observed, after)
                columns.append(-(sensitivity @ change[..., None])[..., 0] / size)
            else:
                columns.append((before - residuals(after, theta)) / size)
    return np.stack(columns, axis=-1) if columns else np.zeros((len(observed), SIZE, 0))
