"""What of an estimate can be used: well known parameters, sums of others, the predicted centre of mass."""

from __future__ import annotations

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, relative_standard_errors

INTERVAL = 1.96  # half of a 95 % interval, in standard errors


def known_sums(estimate: Estimate) -> list[tuple[str, float, float]]:
    """Return sums and differences that are well known though neither of their two parameters is.

    Returns:
        name, value and standard error [m] of each.
    """
    found, shares = [], estimate.relative_standard_error
    place = {number: k for k, number in enumerate(estimate.numbers.tolist())}
    for first, second, correlation in estimate.high_correlations:
        a, b = place[first], place[second]
        weights = np.zeros(len(shares))
        weights[[a, b]] = 1.0, -np.sign(correlation)
        value, error = weights @ estimate.value, np.sqrt(weights @ estimate.covariance @ weights)
        apart = min(shares[a], shares[b]) >= WELL_IDENTIFIED
        if apart and relative_standard_errors(value, error) < WELL_IDENTIFIED:
            sign = "-" if correlation > 0 else "+"
            found.append((f"{estimate.names[a]} {sign} {estimate.names[b]}", float(value), float(error)))
    return found


def usable_line(
    estimate: Estimate, parameters: BaseParameters, angles: np.ndarray, support: np.ndarray
) -> str:
    """Say how much of a full model can be used.

    Args:
        angles: of the postures, (m, n_joints) [rad]. support: see `BaseParameters.regressor`, (m,).
    """
    matrix = parameters.regressor(angles, support).reshape(2 * len(angles), -1)
    variance = np.einsum("ij,jk,ik->i", matrix, estimate.covariance, matrix)
    sums, count = len(known_sums(estimate)), int((estimate.relative_standard_error < WELL_IDENTIFIED).sum())
    others = f" and {sums} sum{'s' * (sums > 1)} of others" if sums else ""
    reach = number(1e3 * INTERVAL * float(np.sqrt(variance.mean())), ".2g")
    return (
        f"Usable: {count} of {len(estimate.value)} parameters{others} are known better than "
        f"{WELL_IDENTIFIED:.0f} %; the centre of mass of these postures is predicted within ± {reach} mm per "
        "axis (95 %)."
    )
