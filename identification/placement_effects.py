"""What errors that a placement's postures share do to the standard errors of least squares.

A plate that does not lie where it was recorded shifts its own reading, so the centre of
pressure moves by the load share on that plate times the error: for both axes, in all postures
of the placement. Eq. 14 takes those for independent. Here e = Z_r u_r + Z_l u_l + w with
variances that restricted maximum likelihood estimates (`variance_components`), without any data
sheet; least squares then has the covariance C H' V H C.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.identification.regressor import Regression
from tulip_testbed.identification.variance_components import fit_components
from tulip_testbed.sim.measurements import SensorSheet


def clustered_covariance(data: Regression, c: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Covariance of eq. 8's estimate when placements share errors.

    Args:
        data: the regression.
        c: (H'H)^-1, (p, p).

    Returns:
        covariance (p, p) [m2] and the s.d. of the right and left plate's placement errors [m].
    """
    fit = fit_components(replace(data, cells=None, levers=None, sensors=SensorSheet()), None)
    rows = data.matrix[fit.rows] * (fit.rows >= 0)[..., None]
    spread = np.tensordot(rows, np.linalg.solve(fit.inverse, rows), axes=((0, 1), (0, 1)))
    return c @ spread @ c, fit.placement_sd
