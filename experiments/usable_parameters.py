"""The usable part of an estimate: well known parameters, sums of others, the predicted centre of mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Array
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, relative_standard_errors


@dataclass(frozen=True, eq=False)
class ConstantError:
    """The mean residual of the centre of pressure, which the estimate takes as the laboratory's.

    Attributes:
        mean: residual over all rows, in x and y, (2,) [m]. half_width: of its 95 % interval, (2,) [m].
        share: of the residuals' mean square, (2,).
    """

    mean: Array
    half_width: Array
    share: Array

    def __str__(self) -> str:
        x, y = (
            f"{number(1e3 * mean, '+.2f')} ± {number(1e3 * half, '.2f')} mm ({number(100 * share, '.0f')} %)"
            for mean, half, share in zip(self.mean, self.half_width, self.share, strict=True)
        )
        return (
            f"Constant error of the centre of pressure (share of the residuals' mean square): x {x}, y {y}. "
            "It is taken as the laboratory's, such as plates and tilt, and is in no parameter."
        )


def constant_error(estimate: Estimate, regressor: np.ndarray) -> ConstantError:
    """Return the mean of the residuals that an estimate leaves.

    Args:
        regressor: of the postures, (m, 2, p).
    """
    residual, mean = estimate.residual.reshape(-1, 2), regressor.mean(axis=0)
    error = np.sqrt(np.diag(mean @ estimate.covariance @ mean.T))
    constant = residual.mean(axis=0)
    return ConstantError(constant, 1.96 * error, constant**2 / (residual**2).mean(axis=0))


def known_sums(estimate: Estimate) -> list[str]:
    """Return sums and differences that are well known though neither of their two parameters is."""
    found, shares = [], dict(zip(estimate.numbers.tolist(), estimate.relative_standard_error, strict=True))
    for first, second, correlation in estimate.high_correlations:
        sign = -1.0 if correlation > 0 else 1.0
        weights = (estimate.numbers == first) + sign * (estimate.numbers == second)
        value, error = weights @ estimate.value, np.sqrt(weights @ estimate.covariance @ weights)
        if relative_standard_errors(value, error) < WELL_IDENTIFIED <= min(shares[first], shares[second]):
            names = [estimate.names[list(shares).index(one)] for one in (first, second)]
            size = f"{1e3 * value:.2f} mm, standard error {1e3 * error:.2f} mm"
            found.append(f"{(' + ' if sign > 0 else ' - ').join(names)} = {size}.")
    return found


def usable_line(shares: np.ndarray, missed: float, sums: int = 0) -> str:
    """Say how much of a full model can be used.

    Args:
        shares: relative standard errors, (p,) [%]. missed: standard error of the predicted centre of mass per
            axis [m]. sums: see `known_sums`.
    """
    others = f" and {sums} sum{'s' * (sums > 1)} of others" if sums else ""
    return (
        f"Usable: {(shares < WELL_IDENTIFIED).sum()} of {len(shares)} parameters{others} are known better "
        f"than {WELL_IDENTIFIED:.0f} %; the centre of mass of these postures is predicted within "
        f"± {number(1.96e3 * float(missed), '.2g')} mm per axis (95 %)."
    )
