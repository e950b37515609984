"""What every estimator returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class StandardEstimate:
    """Masses and centres of mass of the links, after the prior of the robot's own model was added.

    Attributes:
        links: names, (n,).
        mass, mass_error, mass_share: value and standard error [kg], and how much of the prior's variance the
            measurements took away, 0 (all prior) to 1 (all data), (n,).
        center, center_error, center_share: the same of the centre of mass in the link's frame, (n, 3) [m].
        visible: in words, which masses the measurements can give at all.
    """

    links: tuple[str, ...]
    mass: np.ndarray
    mass_error: np.ndarray
    mass_share: np.ndarray
    center: np.ndarray
    center_error: np.ndarray
    center_share: np.ndarray
    visible: str


@dataclass(frozen=True)
class Estimate:
    """An estimate and what it says of its own errors.

    Attributes:
        numbers, names: of the parameters, (p,).
        value: (p,) [m].
        covariance: as the estimator's own model of the errors has it, (p, p) [m2]; least squares:
            sigma^2 C, C = (H'H)^-1, for independent errors (eqs 13, 14).
        clustered_covariance: with errors common to a placement allowed for, (p, p) [m2]; the same
            as `covariance` where the estimator's own model has them.
        residual: e = y - H theta (eq. 12), (2m,) [m].
        sigma: eq. 14 [m].
        placement_sd: estimated s.d. per axis of the placement errors of the right and left plate [m].
        dof: r - p.
        interval_dof: degrees of freedom of each parameter's t interval by `covariance`, (p,).
        condition_number: of H.
        standard: link masses and centres of mass, where the estimator gives them.
    """

    numbers: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    clustered_covariance: np.ndarray
    residual: np.ndarray
    sigma: float
    placement_sd: tuple[float, float]
    dof: int
    interval_dof: np.ndarray
    condition_number: float
    standard: StandardEstimate | None = None
